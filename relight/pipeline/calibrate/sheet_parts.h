// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "relight/pipeline/calibrate/calibrate_pipeline.h"
#include "relight/pipeline/calibrate/light_pictures.h"

/// @file
/// Common parts of the calibrations from a sheet: the sheet as read, their options, and the
/// conversion of a fit to the list of lights.

namespace haarlight::relight {

/// A sheet in blocks, as the camera straight above sees it.
struct ReadSheet {
  TargetSamples samples;
  SheetLayout layout;
};

[[nodiscard]] CalibrationOptions sheet_calibration_options(
    const CalibratePipelineOptions& options);
[[nodiscard]] FreeLightOptions free_light_options(const CalibratePipelineOptions& options);

/// Unknown values are left out: no sigma without a passed test.
/// @param is_known  it passed
[[nodiscard]] FoundLight found_light(const CalibratedLight& light, const std::string& name,
                                     bool is_known);
/// Names are the pictures'; powers of an import's lights are multiplied by those of its
/// session.
void add_lights(const LightCalibration& fit, const LightPictures& pictures, bool is_known,
                FoundLights& found);
/// sheet.png: what remains of the sheet.
void add_sheet_picture(const TargetSamples& samples, const std::vector<double>& albedo,
                       FoundLights& found);

}  // namespace haarlight::relight
