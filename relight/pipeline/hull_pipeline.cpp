// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/hull_pipeline.h"

#include <algorithm>
#include <filesystem>
#include <set>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/render/mesh/mesh_writer.h"
#include "relight/hull/hull_cells.h"
#include "relight/hull/hull_preview.h"
#include "relight/hull/hull_surface.h"
#include "relight/pipeline/picture_notes.h"
#include "relight/pipeline/result_lines.h"
#include "render/cell_mesh/vtu_writer.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;

void check_options(const HullPipelineOptions& options) {
  std::set<std::string> seen;
  for (const std::string& file : options.outputs) {
    const std::string extension = fs::path(file).extension().string();
    if (extension != ".ply" && extension != ".vtu" && extension != ".png") {
      throw Error("a hull is written as .ply, .vtu or .png", file,
                  "name the output hull.ply for a surface, hull.vtu for cells, hull.png for a "
                  "picture of it",
                  ExitCode::usage);
    }
    if (!seen.insert(extension).second) {
      throw Error(fmt::format("a second output that ends in {}", extension), file,
                  "leave one of them out", ExitCode::usage);
    }
    require_absent(file, options.settings.overwrites);
  }
  if (options.n_frames > 0 && !seen.contains(".png")) {
    throw Error("--frames are views in a .png, and no output ends so", "command line",
                "add -o turning.png, or leave out --frames", ExitCode::usage);
  }
  require_heights(options.captured);
}

/// Everything that the outputs are made from.
struct HullJob {
  const HullPipelineOptions& options;
  const ShadowHull& hull;
  const render::SurfaceMesh& surface;  ///< empty: no output needs it
};

void write_preview(const HullJob& job, const std::string& file) {
  const ShadowCaptures captures(job.options.captured, job.options.settings.memory_bytes);
  const ProgressStyle progress = job.options.settings.progress;
  const Image<float> picture =
      job.options.n_frames > 0
          ? hull_turning(job.hull, job.surface, captures.frame(), job.options.n_frames,
                         progress)
          : hull_preview(job.hull, job.surface, captures.rig().cameras[0].model,
                         captures.frame(), progress);
  write_image(file, picture.view(), 1.0, notes_of(captures.first().basis.header()));
}

void write_output(const HullJob& job, const std::string& file, HullPipelineSummary& summary) {
  const std::string extension = fs::path(file).extension().string();
  if (extension == ".ply") {
    render::write_ply(job.surface, file);
  } else if (extension == ".vtu") {
    const HullCells cells = hull_cells(job.hull);
    summary.n_cells = static_cast<std::int64_t>(cells.mesh.cells.size());
    summary.median_height_range_mm = cells.median_height_range_mm;
    render::write_vtu(cells.mesh, file);
  } else {
    write_preview(job, file);
  }
  summary.bytes += fs::file_size(file);
}

std::string output_words(const HullPipelineOptions& options,
                         const HullPipelineSummary& summary) {
  std::string text;
  for (const std::string& file : options.outputs) {
    const std::string extension = fs::path(file).extension().string();
    text += extension == ".ply"
                ? fmt::format("{}: {} triangles around {:.4g} cm^3{}\n", file,
                              summary.n_triangles, 1e-3 * summary.volume_mm3,
                              options.n_smoothings == 0 ? "" : ", smoothed within half a voxel")
            : extension == ".vtu"
                ? fmt::format(
                      "{}: {} cells; half of them lie in a run of {:.3g} mm or less "
                      "over the plane that nothing tells apart\n",
                      file, summary.n_cells, summary.median_height_range_mm)
            : options.n_frames > 0
                ? fmt::format("{}: {} views from all around, one below the other\n", file,
                              options.n_frames)
                : fmt::format("{}: seen by the camera, from the front, the right and above\n",
                              file);
  }
  return text + hull_words(summary.source);
}

}  // namespace

HullPipelineSummary export_hull(const HullPipelineOptions& options) {
  check_options(options);
  PipelineNotes told(options.settings.tell);
  HullPipelineSummary summary;
  CapturedHull found =
      captured_hull(options.captured, options.voxel_mm, options.settings, told);
  summary.source = std::move(found.source);
  require_object(found.hull, options.captured.basis);
  render::SurfaceMesh surface;
  if (std::any_of(options.outputs.begin(), options.outputs.end(),
                  [](const fs::path& file) { return file.extension() != ".vtu"; })) {
    surface = hull_surface(found.hull, {options.n_smoothings});
  }
  summary.n_triangles = static_cast<std::int64_t>(surface.triangles.size());
  const HullSummary& counts = summary.source.hull;
  const double side = counts.voxel_mm;
  summary.volume_mm3 =
      static_cast<double>(counts.n_matter + counts.n_assumed_full) * side * side * side;
  for (const std::string& file : options.outputs) {
    write_output({options, found.hull, surface}, file, summary);
  }
  tell_lines(output_words(options, summary), told);
  summary.notes = told.all();
  return summary;
}

void add_to_report(const HullPipelineOptions& options, const HullPipelineSummary& summary,
                   Report& report) {
  report.add_input(options.captured.basis);
  for (const std::string& file : options.captured.also) {
    report.add_input(file);
  }
  if (options.captured.height) {
    report.add_requested(
        "object_height_mm",
        std::vector<double>{options.captured.height->low_mm, options.captured.height->high_mm});
  }
  if (is_plate_captured(options.captured)) {
    report.add_input(options.captured.plate);
  }
  report.add_detail("plate", options.captured.plate);
  add_to_report(summary.source, report);
  report.add_achieved("volume_mm3", summary.volume_mm3);
  if (summary.n_triangles > 0) {
    report.add_detail("triangles", summary.n_triangles);
  }
  if (summary.n_cells > 0) {
    report.add_detail("cells", summary.n_cells);
    report.add_achieved("height_range_mm", summary.median_height_range_mm);
  }
  report.set_bytes(summary.bytes);
}

}  // namespace haarlight::relight
