// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "core/report.h"
#include "relight/shadow/rig_predict.h"

/// @file
/// A rig's prediction as lines for the user, as JSON and in a report. Pure.

namespace haarlight::relight {

/// @param strip_mm  PredictOptions::strip_mm of the prediction
[[nodiscard]] std::string prediction_text(const RigPrediction& prediction, double strip_mm);
[[nodiscard]] std::string prediction_json(const RigPrediction& prediction);
/// What was requested and, for the first plane, achieved.
void add_to_report(const PredictOptions& options, const RigPrediction& prediction,
                   Report& report);

}  // namespace haarlight::relight
