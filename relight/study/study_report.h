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
/// @param compress  as for recommendation_text(), like `plate`
[[nodiscard]] std::string study_json(const BasisStudy& study, const std::string& name,
                                     const std::string& compress = "haarlight compress SESSION",
                                     const std::string& plate = {});

/// One record for each basis coded once and each picture (and the stack),
/// docs/reference/tradeoff.schema.json.
/// @param command  that produced it
[[nodiscard]] std::vector<TradeoffRecord> study_records(const BasisStudy& study,
                                                        const std::string& command,
                                                        int n_threads);

/// The basis with the fewest bytes at one error, of those that compress can write.
struct Recommendation {
  double error = 0.0;  ///< relative L2 of the stack: requested, and achieved in the study
  std::string basis;   ///< of `haarlight compress --basis`
  bool has_plate = false;
  std::uint64_t bytes = 0;  ///< of the pixels studied, by the study's packer
  /// What is smaller still and cannot be written; empty: nothing.
  std::string smaller;
};
/// One for each requested error that such a basis achieves.
[[nodiscard]] std::vector<Recommendation> recommendations(const BasisStudy& study);
/// Which bases compress can write, which not and why; then the recommendations.
/// @param compress  the command without basis, plate and error: "haarlight compress SESSION ..."
/// @param plate     what the command says of the clean plate where one is subtracted; may be
///                  empty
[[nodiscard]] std::string recommendation_text(const BasisStudy& study,
                                              const std::string& compress,
                                              const std::string& plate);
/// The command that writes it.
[[nodiscard]] std::string recommended_command(const Recommendation& found,
                                              const std::string& compress,
                                              const std::string& plate);

struct StudyFigure {
  std::string file;  ///< name with .svg
  std::string svg;
};
[[nodiscard]] std::vector<StudyFigure> study_figures(const BasisStudy& study);

}  // namespace haarlight::relight
