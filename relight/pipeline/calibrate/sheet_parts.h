// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "relight/pipeline/calibrate/calibrate_pipeline.h"
#include "relight/pipeline/calibrate/light_pictures.h"

/// @file
/// What the calibrations from a sheet share: the sheet as it was read, their options, and how a
/// fit becomes the list of lights.

namespace haarlight {

/// A sheet in blocks, as the camera straight above sees it.
struct ReadSheet {
  TargetSamples samples;
  SheetLayout layout;
};

[[nodiscard]] CalibrationOptions sheet_calibration_options(
    const CalibratePipelineOptions& options);
[[nodiscard]] FreeLightOptions free_light_options(const CalibratePipelineOptions& options);

/// What cannot be known is not said: no sigma without a test that passed.
/// @param is_known  it passed
[[nodiscard]] FoundLight found_light(const CalibratedLight& light, const std::string& name,
                                     bool is_known);
/// Names are the pictures'; powers of an import's lights multiply what its session had.
void add_lights(const LightCalibration& fit, const LightPictures& pictures, bool is_known,
                FoundLights& found);
/// sheet.png: what remains of the sheet.
void add_sheet_picture(const TargetSamples& samples, const std::vector<double>& albedo,
                       FoundLights& found);

}  // namespace haarlight
