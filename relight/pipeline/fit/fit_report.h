// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "core/report.h"
#include "core/tradeoff.h"
#include "relight/pipeline/fit/fit_pipeline.h"

/// @file
/// Reports of a fit: a table for users, entries of a report, tradeoff records. Pure.

namespace haarlight::relight {

/// Two lines: the column headings.
[[nodiscard]] std::string fit_table_head(FitTruth truth);
/// One form's line of the table, and that of the light-domain basis.
[[nodiscard]] std::string fit_table_row(const FormFit& fit);
[[nodiscard]] std::string fit_table_row(const HaarSize& haar);

/// For fit_capture: what was requested, achieved and found.
void report_fit(const FitOptions& options, const FitSummary& summary, Report& report);
/// For compare_fits.
void report_fits(const FitOptions& options, const FitSummary& summary, Report& report);

/// The forms of compare_fits as records.
/// @param threads  used
/// @param command  that reproduces them
[[nodiscard]] std::vector<TradeoffRecord> fit_records(const FitSummary& summary, int threads,
                                                      const std::string& command);

}  // namespace haarlight::relight
