// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "apps/haarlight/verb.h"

/// @file
/// `haarlight rig predict`: the design tool.

namespace haarlight::apps {

struct PredictArguments {
  std::vector<double> object_height;  ///< LOW, HIGH
  double strip_mm = 10.0;
  double sun_deg = 0.53;
  std::vector<double> receivers;
};

/// Prints the prediction, as JSON if requested, and adds it to the report.
void run_predict(const std::string& rig, const PredictArguments& arguments, bool is_json,
                 Report& report);

}  // namespace haarlight::apps
