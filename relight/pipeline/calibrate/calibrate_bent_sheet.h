// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "relight/pipeline/calibrate/sheet_parts.h"

/// @file
/// Lights from a sheet that is not flat: its shape and the lights by alternation.

namespace haarlight::relight {

/// Starts from the lights found for a flat sheet. No standard errors: lights can hide a bend in
/// the noise.
/// @param findings  the alternation: filled in
[[nodiscard]] FoundLights find_by_bent_sheet(const CalibratePipelineOptions& options,
                                             const ReadSheet& sheet,
                                             const LightPictures& pictures,
                                             SheetFindings& findings, PipelineNotes& notes);

/// From the lowest to the highest point of a bent sheet, mm.
[[nodiscard]] double bent_range_mm(const Alternation& found);

}  // namespace haarlight::relight
