// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "relight/pipeline/calibrate/calibrate_pipeline.h"
#include "relight/pipeline/calibrate/light_pictures.h"

/// @file
/// Lights from mirror balls, found or masked: far lights' directions from one ball, near lights'
/// places from several.

namespace haarlight {

/// @param findings  balls and, of near lights, the scene: filled
/// @throws Error  no ball, or other ones than were asked for; options that do not suffice; a
///                mask that does not fit; highlights that do not move
[[nodiscard]] FoundLights find_by_balls(const CalibratePipelineOptions& options,
                                        const LightPictures& pictures, BallFindings& findings,
                                        PipelineNotes& notes);

}  // namespace haarlight
