// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "apps/haarlight/options/develop_options.h"
#include "apps/haarlight/verb.h"
#include "relight/pipeline/shape/shape_pipeline.h"

/// @file
/// The command line of `haarlight shape`.

namespace haarlight::apps {

struct ShapeArguments {
  std::string input;
  std::string out;
  std::string method;  ///< empty: chosen by lights held out, or what the file holds
  std::string loss = "tukey";
  std::string light = "automatic";
  std::string integrate = "poisson";
  std::string mesh = "both";
  std::string mask = "found";  ///< found, none, or a picture
  std::string transfer;
  PlaneArguments plane;
  double keep = relight::LambertOptions{}.keep;
  double dark_fraction = relight::LambertOptions{}.dark_fraction;
  double max_tilt_deg = relight::SurfaceMeshOptions{}.max_tilt_deg;
  int max_rounds = relight::ShapeOptions{}.max_rounds;
  bool is_open_at_cuts = false;
  std::vector<double> preview = {0.5, 0.5, 1.0};
};

void add_shape_options(Command verb, ShapeArguments& arguments);

[[nodiscard]] relight::ShapePipelineOptions shape_options(const ShapeArguments& arguments,
                                                          const CommonOptions& common);

}  // namespace haarlight::apps
