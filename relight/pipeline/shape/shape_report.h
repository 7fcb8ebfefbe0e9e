// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "core/report.h"
#include "relight/pipeline/shape/shape_pipeline.h"

/// @file
/// What a recovered surface says of itself: lines for people, doubts, entries of a report. Pure.

namespace haarlight {

/// Lines, each with its end: what was found and how well it is known.
[[nodiscard]] std::string shape_text(const ShapePipelineOptions& options,
                                     const ShapeSummary& summary);

/// What the capture cannot tell, and what would: each a warning.
[[nodiscard]] std::vector<std::string> shape_warnings(const ShapeSummary& summary);

/// Reached values and details.
void report_shape(const ShapeSummary& summary, Report& report);

/// What this share of the known normals' standard errors lies below, degrees.
[[nodiscard]] double sigma_below(const ShapeSummary& summary, double share);

}  // namespace haarlight
