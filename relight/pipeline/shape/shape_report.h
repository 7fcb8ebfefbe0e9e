// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "core/report.h"
#include "relight/pipeline/shape/shape_pipeline.h"

/// @file
/// Reports of a recovered surface: lines for users, caveats, entries of a report. Pure.

namespace haarlight::relight {

/// Lines, each with its end: the findings and their uncertainty.
[[nodiscard]] std::string shape_text(const ShapePipelineOptions& options,
                                     const ShapeSummary& summary);

/// Why the surface is not usable, one message each; empty where it is.
[[nodiscard]] std::vector<std::string> shape_failures(const ShapeSummary& summary);

/// What the capture cannot determine, and what would: each a warning.
[[nodiscard]] std::vector<std::string> shape_warnings(const ShapeSummary& summary);

/// Achieved values and details.
void report_shape(const ShapeSummary& summary, Report& report);

/// The quantile of the known normals' standard errors at this fraction, degrees.
[[nodiscard]] double sigma_below(const ShapeSummary& summary, double fraction);

}  // namespace haarlight::relight
