// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/report.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/basis/basis_file.h"
#include "relight/pipeline/pipeline_settings.h"
#include "relight/study/basis_study.h"

/// @file
/// Bases over the lights compared on one's own capture: opens a session or a basis file, runs
/// the study (relight/study/basis_study.h) and writes its tables, figures and records.

namespace haarlight::relight {

struct BasesOptions {
  std::string input;   ///< session folder, or a basis file
  std::string output;  ///< folder for bases.txt, bases.json, records.json, figures, regions.png
  std::vector<std::string> bases;  ///< words of known_bases(); empty: all
  std::vector<double> errors;      ///< relative L2 to achieve; empty: BasisStudyOptions' own
  std::vector<double> sizes;       ///< numbers per pixel to spend; empty: the same
  std::string plate;               ///< as PlateChoice::parse; empty: computed from the rig
  std::string lightings;           ///< JSON object of names; empty: the default ones
  std::string regions;             ///< picture of the regions; empty: classified
  int n_tiles = 8;                 ///< of 128 pixels per side; 0: all
  int sh_order = 15;
  int pca_rank = 512;
  std::optional<Transfer> unknown_as;  ///< for the unknown curve of a camera's YUYV or NV12
  int threads = 0;                     ///< for the records; 0: one per core
  PipelineSettings settings;
};

struct BasesSummary {
  BasisStudy study;
  PlateOrigin plate_origin = PlateOrigin::none;
  bool is_achieved = true;  ///< every basis achieved every error that it can achieve
  std::uint64_t bytes = 0;
  std::vector<PipelineNote> notes;  ///< all messages
};

/// @throws Error  a capture that cannot be read or does not give its lights' positions, a
///                a clean plate, lightings or regions that do not fit, an output that exists
[[nodiscard]] BasesSummary compare_bases(const BasesOptions& options);

/// What was requested and achieved.
void add_to_report(const BasesOptions& options, const BasesSummary& summary, Report& report);

}  // namespace haarlight::relight
