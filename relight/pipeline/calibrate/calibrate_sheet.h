// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "relight/pipeline/calibrate/calibrate_pipeline.h"
#include "relight/pipeline/calibrate/light_pictures.h"

/// @file
/// Lights from a sheet: free ones, or an array whose layout is known; of a sheet that is flat, or
/// of one that is not.

namespace haarlight {

/// @param findings  filled
/// @throws Error(usage)  a camera that is not told, a grid that is not the pictures'
/// @throws Error  one picture, a grid that is seen from its back; as the calibrations
[[nodiscard]] FoundLights find_by_sheet(const CalibratePipelineOptions& options,
                                        const LightPictures& pictures, SheetFindings& findings,
                                        PipelineNotes& notes);

}  // namespace haarlight
