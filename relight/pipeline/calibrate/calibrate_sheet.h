// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "relight/pipeline/calibrate/calibrate_pipeline.h"
#include "relight/pipeline/calibrate/light_pictures.h"

/// @file
/// Lights from a sheet: free ones, or an array of known layout; flat sheets or bent ones.

namespace haarlight::relight {

/// @param findings  filled
/// @throws Error(usage)  a camera not given, a grid that does not match the pictures
/// @throws Error  one picture, a grid that is seen from its back; as the calibrations
[[nodiscard]] FoundLights find_by_sheet(const CalibratePipelineOptions& options,
                                        const LightPictures& pictures, SheetFindings& findings,
                                        PipelineNotes& notes);

}  // namespace haarlight::relight
