// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>

#include "apps/haarlight/options/picture_options.h"
#include "apps/haarlight/verb.h"
#include "relight/pipeline/fit/fit_pipeline.h"

/// @file
/// The command line of `haarlight fit`.

namespace haarlight::apps {

struct FitArguments {
  std::string capture;
  std::string lights;
  PictureListArguments list;
  std::optional<relight::FitForm> form;  ///< nothing: the one that predicts lights best
  std::string out;
  std::string hold_out;
  Transfer transfer = Transfer::srgb;
  std::string records;
  std::optional<relight::NearSolve> near;  ///< nothing: far lights
  double width_mm = 0.0;
  bool compare = false;
  bool extremes = false;
  int max_planes = relight::FormOptions{}.max_planes;
  int resolution = relight::FormOptions{}.resolution;
  std::optional<double> ridge;
  relight::FitSize size;
  std::string bytes;
};

void add_fit_options(Command verb, FitArguments& arguments);

/// @throws Error(usage)  what is no rectangle, no number of bytes, no EVERY:REST
[[nodiscard]] relight::FitOptions fit_options(const FitArguments& arguments,
                                              const CommonOptions& common);

}  // namespace haarlight::apps
