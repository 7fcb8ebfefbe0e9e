// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/report.h"
#include "relight/pipeline/captured_hull.h"
#include "relight/pipeline/pipeline_settings.h"
#include "relight/pipeline/shadow_captures.h"

/// @file
/// From basis files to the captured object's shadow hull as a surface, as cells, or as a picture
/// of it. docs/numerics/hull.md.

namespace haarlight::relight {

struct HullPipelineOptions {
  CapturedObject captured;
  std::vector<std::string> outputs;  ///< .ply surface, .vtu cells, .png preview; one of each
  double voxel_mm = 0.0;             ///< 0: chosen (relight/hull/shadow_hull.h)
  int n_smoothings = 12;             ///< of the surface; 0: the voxels' own faces
  int n_frames = 0;                  ///< of the .png: views all around; 0: the four views
  PipelineSettings settings;
};

struct HullPipelineSummary {
  HullSource source;
  double volume_mm3 = 0.0;              ///< of the voxels that are taken as matter
  std::int64_t n_triangles = 0;         ///< 0: only a .vtu
  std::int64_t n_cells = 0;             ///< 0: no .vtu
  double median_height_range_mm = 0.0;  ///< of the cells (relight/hull/hull_cells.h)
  std::uint64_t bytes = 0;              ///< of all outputs
  std::vector<PipelineNote> notes;
};

/// Carves the hull, or reads it where it is kept, and writes the outputs.
/// @throws Error(usage)  an output's name that says no format, or one twice; frames, and no .png
/// @throws Error  as captured_hull(); an output that exists; captures without an object
[[nodiscard]] HullPipelineSummary export_hull(const HullPipelineOptions& options);

void add_to_report(const HullPipelineOptions& options, const HullPipelineSummary& summary,
                   Report& report);

}  // namespace haarlight::relight
