// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "relight/pipeline/calibrate/calibrate_pipeline.h"
#include "relight/pipeline/calibrate/light_pictures.h"

/// @file
/// Lights from mirror balls, found or masked: far lights' directions from one ball, near
/// lights' positions from several.

namespace haarlight::relight {

/// @param findings  balls and, for near lights, the scene: filled in
/// @throws Error  no ball, or a different number than requested; insufficient options; a mask
///                that does not fit; highlights that do not move
[[nodiscard]] FoundLights find_by_balls(const CalibratePipelineOptions& options,
                                        const LightPictures& pictures, BallFindings& findings,
                                        PipelineNotes& notes);

}  // namespace haarlight::relight
