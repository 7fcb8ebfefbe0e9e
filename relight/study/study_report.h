// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "core/tradeoff.h"
#include "relight/study/basis_study.h"

/// @file
/// Output of a comparison of bases for readers and programs: tables, figures, JSON, records.

namespace haarlight::relight {

/// Equal error and equal size over the whole capture.
[[nodiscard]] std::string summary_tables(const BasisStudy& study);
/// The error of a basis at this many bytes per pixel: log-linear interpolation between its
/// points; NaN outside them.
[[nodiscard]] double error_at_bytes(const BasisResult& result, double bytes_per_pixel,
                                    std::uint64_t n_pixels);
/// Each region separately under each lighting, and the array with fewer lights.
[[nodiscard]] std::string region_tables(const BasisStudy& study);
[[nodiscard]] std::string binning_table(const BasisStudy& study);

/// Every figure of the study. Keys: docs/numerics/bases.md, "bases.json".
[[nodiscard]] std::string study_json(const BasisStudy& study, const std::string& name);

/// One record for each basis coded once and each picture (and the stack),
/// docs/reference/tradeoff.schema.json.
/// @param command  that produced it
[[nodiscard]] std::vector<TradeoffRecord> study_records(const BasisStudy& study,
                                                        const std::string& command,
                                                        int n_threads);

struct StudyFigure {
  std::string file;  ///< name with .svg
  std::string svg;
};
[[nodiscard]] std::vector<StudyFigure> study_figures(const BasisStudy& study);

}  // namespace haarlight::relight
