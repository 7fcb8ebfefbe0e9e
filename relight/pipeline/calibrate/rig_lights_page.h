// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "haarlight/core/rig/rig.h"
#include "relight/pipeline/calibrate/rig_lights_pipeline.h"

/// @file
/// A page that shows the calibration of a rig's lights.

namespace haarlight::relight {

/// HTML: each face's pose and its errors, maps of the lights' powers and of the sheet.
/// @param date     ISO 8601
/// @param session  its name, as given
[[nodiscard]] std::string rig_lights_page(const Rig& rig, const RigFaces& fit,
                                          const std::string& date, const std::string& session);

}  // namespace haarlight::relight
