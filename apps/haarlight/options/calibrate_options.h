// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "apps/haarlight/verb.h"
#include "haarlight/core/picture/image_io.h"
#include "relight/pipeline/calibrate/calibrate_pipeline.h"

/// @file
/// The command line of `haarlight calibrate`.

namespace haarlight::apps {

struct FindLightsArguments {
  std::string input;
  std::string out;
  std::optional<relight::LightTarget> target;  ///< nothing: what the input says
  std::vector<std::string> exclude;
  std::optional<Transfer> transfer;  ///< nothing: as the file says
  double width_mm = 0.0;             ///< 0: not given
  double camera_mm = 0.0;            ///< 0: not given
  double focal_px = 0.0;             ///< 0: not given
  // balls
  std::vector<std::string> masks;
  int n_balls = 1;
  std::vector<double> radius_mm;
  double edge_px = 0.5;
  // a sheet
  std::vector<double> region;
  relight::Aim aim = relight::Aim::centre;
  double aim_deg = 3.0;
  double tilt_deg = 1.0;
  double led_mm = 0.0;
  relight::Lobe lobe = relight::Lobe::free;
  double mu = 1.0;
  double bow_mm = 1.0;
  int samples = 32;
  bool is_bent = false;
  std::vector<int> grid;  ///< rows, columns
  double pitch_mm = 0.0;
  // a rig
  std::string rig;
  double sheet_mm = 0.0;
  std::string page;
};

void add_calibrate_options(Command verb, FindLightsArguments& arguments);

}  // namespace haarlight::apps
