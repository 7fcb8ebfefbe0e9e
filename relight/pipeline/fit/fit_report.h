// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "core/report.h"
#include "core/tradeoff.h"
#include "relight/pipeline/fit/fit_pipeline.h"

/// @file
/// What a fit says of itself: a table for people, entries of a report, tradeoff records. Pure.

namespace haarlight {

/// What a file's pictures are held against, for people.
[[nodiscard]] const char* to_string(FitTruth truth) noexcept;

/// Two lines: what the columns are.
[[nodiscard]] std::string fit_table_head(FitTruth truth);
/// One form's line of the table, and that of the light-domain basis.
[[nodiscard]] std::string fit_table_row(const FormFit& fit);
[[nodiscard]] std::string fit_table_row(const HaarSize& haar);

/// Of fit_capture: what was asked, reached and found on the way.
void report_fit(const FitOptions& options, const FitSummary& summary, Report& report);
/// Of compare_fits.
void report_fits(const FitOptions& options, const FitSummary& summary, Report& report);

/// The forms of compare_fits as records.
/// @param threads  that were used
/// @param command  that gives them again
[[nodiscard]] std::vector<TradeoffRecord> fit_records(const FitSummary& summary, int threads,
                                                      const std::string& command);

}  // namespace haarlight
