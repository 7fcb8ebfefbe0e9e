// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/rig/rig_predict.h"

#include <fmt/format.h>

#include "haarlight/core/rig/rig.h"
#include "relight/shadow/rig_predict_words.h"

namespace haarlight::apps {

void run_predict(const std::string& rig, const PredictArguments& arguments, bool is_json,
                 Report& report) {
  if (arguments.object_height.size() != 2) {
    throw Error("the object's height is not known", "--object-height",
                "write its lowest and highest point over the plane in mm, for example 76,128",
                ExitCode::usage);
  }
  const relight::PredictOptions options{.low_mm = arguments.object_height[0],
                                        .high_mm = arguments.object_height[1],
                                        .strip_mm = arguments.strip_mm,
                                        .sun_deg = arguments.sun_deg,
                                        .receivers = arguments.receivers};
  const relight::RigPrediction prediction = relight::predict_rig(read_rig(rig), options);
  relight::add_to_report(options, prediction, report);
  if (is_json) {
    fmt::print("{}\n", relight::prediction_json(prediction));
  } else {
    fmt::print("{}", relight::prediction_text(prediction, options.strip_mm));
  }
}

}  // namespace haarlight::apps
