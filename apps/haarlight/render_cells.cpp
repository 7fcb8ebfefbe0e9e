// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/render_cells.h"

#include <algorithm>
#include <array>
#include <filesystem>
#include <utility>

#include <fmt/format.h>

#include "apps/haarlight/volume_comparison.h"
#include "core/counted.h"
#include "haarlight/core/error.h"
#include "render/loop/tile_renderer.h"
#include "render/volume/volume_ray_caster.h"

namespace haarlight::apps {

namespace {

render::PreviewOptions preview_options(const VolumeArguments& arguments) {
  render::PreviewOptions options;
  options.method = arguments.preview.value_or(options.method);
  options.order = arguments.order.value_or(options.order);
  return options;
}

render::RunResult render_film(const render::TileRenderer& renderer, const CommonOptions& common,
                              render::Film& film) {
  render::RunOptions run;
  run.samples = 1;
  run.progress = common.progress();
  return render::run(renderer, run, film);
}

/// How its tetrahedra were got, and in which order they were drawn.
void tell_of_preview(const render::VolumeScene& scene, const render::PreviewOptions& options,
                     const render::ProjectedTetrahedra& preview) {
  const render::PreviewCounts& counts = preview.counts();
  fmt::print(
      "a preview, not the exact picture: {} projected tetrahedra, {}, in the order of {}\n",
      counts.drawn, to_string(options.method),
      options.order == render::PreviewOrder::centroid ? "their centroids, which may be wrong"
                                                      : "visibility");
  if (counts.tetrahedra > scene.mesh.n_cells()) {
    fmt::print("cells were cut into tetrahedra {}\n", render::kTetrahedraOfCells);
  }
  if (counts.clipped > 0) {
    fmt::print(
        "{} tetrahedra were cut along the axis; nothing nearer than {:.3g} mm is drawn\n",
        counts.clipped, preview.nearest());
  }
  if (counts.split_cells > 0) {
    fmt::print("{}\n", counted(counts.split_cells,
                               "cell hides parts of others in a ring, and is drawn whole",
                               "cells hide parts of each other in rings, and are drawn whole"));
  }
}

}  // namespace

void check_algorithm(const VolumeArguments& arguments) {
  if (arguments.algorithm != Algorithm::projected_tetrahedra &&
      (arguments.preview || arguments.order)) {
    throw Error(fmt::format("--algorithm {} is no preview", to_string(arguments.algorithm)),
                arguments.preview ? "--preview" : "--order",
                "leave it out, or give --algorithm projected-tetrahedra", ExitCode::usage);
  }
  if (arguments.algorithm != Algorithm::cell_projection &&
      arguments.small_cells == render::SmallCells::splatted) {
    throw Error(fmt::format("--algorithm {} makes no splats", to_string(arguments.algorithm)),
                "--small-cells", "leave it out, or give --algorithm cell-projection",
                ExitCode::usage);
  }
  if (arguments.algorithm == Algorithm::ray_casting) {
    return;
  }
  const std::array<std::pair<bool, const char*>, 4> others = {
      {{arguments.max_error > 0.0, "--max-error"},
       {arguments.mode != render::VolumeMode::exact, "--mode"},
       {arguments.seconds.has_value(), "--seconds"},
       {!arguments.kept.film.empty(), "--film"}}};
  for (const auto& [is_given, option] : others) {
    if (is_given) {
      throw Error("it goes with --algorithm ray-casting alone", option,
                  "leave it out, or give --algorithm ray-casting", ExitCode::usage);
    }
  }
}

void check_preview(const render::VolumeScene& scene, const VolumeArguments& arguments) {
  if (arguments.algorithm != Algorithm::projected_tetrahedra) {
    return;
  }
  const auto refuse = [&](const char* what, const char* table) {
    throw Error(
        what, arguments.scene,
        fmt::format("take its {} out, or leave out --algorithm projected-tetrahedra", table),
        ExitCode::usage);
  };
  if (!scene.contours.empty()) {
    refuse("previews draw no contours", "[[contour]] tables");
  }
  if (scene.surfaces) {
    refuse("previews do not end at surfaces", "[behind] table");
  }
}

std::uint64_t bytes_of_algorithm(const render::VolumeScene& scene,
                                 const VolumeArguments& arguments) {
  switch (arguments.algorithm) {
    case Algorithm::cell_projection:
      return render::CellProjection::bytes_needed(scene, arguments.small_cells);
    case Algorithm::projected_tetrahedra:
      return render::ProjectedTetrahedra::bytes_needed(scene, preview_options(arguments).order);
    case Algorithm::ray_casting:
      break;
  }
  return render::VolumeRayCaster::bytes_needed(scene);
}

void tell_faces(const render::VolumeScene& scene, Report& report) {
  report.add_detail("faces_not_flat",
                    static_cast<std::int64_t>(scene.check.n_non_planar_faces));
  if (scene.check.n_non_planar_faces > 0) {
    const std::size_t n = scene.check.n_non_planar_faces;
    fmt::print("{} not flat, by up to {:.2g} mm: drawn as two triangles each\n",
               counted(n, "face is", "faces are"), scene.check.largest_deviation);
  }
}

ExitCode project_cells(const render::VolumeScene& scene, const VolumeArguments& arguments,
                       const CommonOptions& common, Report& report) {
  const render::CellProjection projection(scene, arguments.small_cells);
  const render::VisibilityOrder& order = projection.order();
  render::Film film(scene.camera.width, scene.camera.height, render::VolumeRayCaster::layers());
  const render::RunResult result = render_film(projection, common, film);
  report.add_detail("exposure", write_volume_pictures(film, arguments.names));
  report.set_bytes(std::filesystem::file_size(arguments.names.output));
  const render::ProjectionCounts counts = projection.counts();
  const auto add = [&report](const char* name, auto n) {
    report.add_detail(name, static_cast<std::int64_t>(n));
  };
  std::size_t n_cyclic = 0;
  std::size_t n_pieces = 0;
  for (const render::CyclicCells& cyclic : order.cyclic) {
    n_cyclic += cyclic.cells.size();
    n_pieces += cyclic.n_pieces;
  }
  report.add_achieved("violations", static_cast<double>(counts.violations));
  add("cells_of_mesh", scene.mesh.n_cells());
  add("cells_outside", order.n_outside);
  add("cells_transparent", projection.n_transparent());
  add("splats", projection.n_splats());
  add("tiles", projection.n_tiles());
  add("stretches", counts.stretches);
  add("segments", counts.segments);
  add("exact_sides", counts.exact_sides);
  add("relations_by_faces", order.n_face_relations);
  add("relations_by_boundary", order.n_other_relations);
  add("exact_signs", order.n_exact);
  add("cyclic_components", order.cyclic.size());
  add("cyclic_cells", n_cyclic);
  add("pieces", n_pieces);
  report.add_detail("order_cpu_seconds", order.cpu_seconds);
  report.add_detail("prepare_seconds", projection.prepare_seconds());
  report.add_detail("render_seconds", result.seconds);
  fmt::print("{}: {} x {} pixels, {}; {:.3g} million stretches in {:.2f} s\n",
             arguments.names.output, film.width(), film.height(),
             counted(scene.mesh.n_cells(), "cell"),
             1e-6 * static_cast<double>(counts.stretches),
             projection.prepare_seconds() + result.seconds);
  constexpr std::size_t kNamed = 20;
  for (std::size_t i = 0; i < std::min(order.cyclic.size(), kNamed); ++i) {
    fmt::print("{}: split into {} pieces\n", name_of(order.cyclic[i], projection.view()),
               order.cyclic[i].n_pieces);
  }
  if (order.cyclic.size() > kNamed) {
    fmt::print("and {} such rings more\n", order.cyclic.size() - kNamed);
  }
  if (projection.n_splats() > 0) {
    fmt::print("{}: not exact\n",
               counted(projection.n_splats(), "cell smaller than two pixels is a splat",
                       "cells smaller than two pixels are splats"));
  }
  report.add_detail("lost_points", static_cast<std::int64_t>(counts.lost_points));
  report.add_detail("unresolved", static_cast<std::int64_t>(counts.unresolved));
  tell_faces(scene, report);
  tell_doubts(facts_of(film), 0.0);
  if (!arguments.comparison.empty()) {
    compare_with_exact(scene, film, arguments.comparison, common.progress(), result.seconds,
                       report);
  }
  if (counts.violations > 0) {
    fmt::print(
        stderr, "{}: {} drawn out of order, the picture is wrong: {}\n", arguments.names.output,
        counted(counts.violations, "stretch was", "stretches were"), projection.violation());
    return ExitCode::target_missed;
  }
  return ExitCode::done;
}

ExitCode draw_preview(const render::VolumeScene& scene, const VolumeArguments& arguments,
                      const CommonOptions& common, Report& report) {
  const render::PreviewOptions options = preview_options(arguments);
  report.add_requested("preview", std::string(to_string(options.method)));
  report.add_requested("order", std::string(to_string(options.order)));
  const render::PreviewMesh mesh(scene);
  const render::ProjectedTetrahedra preview(mesh, options);
  render::Film film(scene.camera.width, scene.camera.height, render::VolumeRayCaster::layers());
  const render::RunResult result = render_film(preview, common, film);
  report.add_detail("exposure", write_volume_pictures(film, arguments.names));
  report.set_bytes(std::filesystem::file_size(arguments.names.output));
  const render::PreviewCounts& counts = preview.counts();
  const auto add = [&report](const char* name, std::size_t n) {
    report.add_detail(name, static_cast<std::int64_t>(n));
  };
  add("cells_of_mesh", scene.mesh.n_cells());
  add("tetrahedra", counts.tetrahedra);
  add("tetrahedra_drawn", counts.drawn);
  add("tetrahedra_clipped", counts.clipped);
  add("cells_drawn_whole", counts.split_cells);
  report.add_detail("prepare_seconds", mesh.prepare_seconds);
  report.add_detail("view_seconds", preview.view_seconds());
  report.add_detail("render_seconds", result.seconds);
  fmt::print("{}: {} x {} pixels, {} in {:.2f} s\n", arguments.names.output, film.width(),
             film.height(), counted(scene.mesh.n_cells(), "cell"),
             mesh.prepare_seconds + preview.view_seconds() + result.seconds);
  tell_of_preview(scene, options, preview);
  if (!arguments.comparison.empty()) {
    compare_with_exact(scene, film, arguments.comparison, common.progress(),
                       preview.view_seconds() + result.seconds, report);
  }
  return ExitCode::done;
}

void add_algorithm_options(Command& verb, VolumeArguments& arguments) {
  verb.option(
      "--algorithm", &arguments.algorithm,
      "How the picture is made: ray-casting: each ray from cell to cell; "
      "cell-projection: cell by cell, in the order in which they are seen. Both are exact. "
      "projected-tetrahedra: a fast, approximate preview",
      {.choices = choices_of({Algorithm::ray_casting, Algorithm::cell_projection,
                              Algorithm::projected_tetrahedra}),
       .shows_default = true});
  verb.option(
      "--preview", &arguments.preview,
      "Of --algorithm projected-tetrahedra: m0: opacity is interpolated; m1: its exponent is "
      "(the "
      "default); m3: as m1, and exact at the thickest point of each tetrahedron",
      {.choices = choices_of({render::Preview::m0, render::Preview::m1, render::Preview::m3})});
  verb.option(
      "--order", &arguments.order,
      "Of --algorithm projected-tetrahedra: centroid: by the tetrahedra's centroids (the "
      "default); "
      "exact: in which the cells are seen",
      {.choices = choices_of({render::PreviewOrder::centroid, render::PreviewOrder::exact})});
  verb.option(
      "--small-cells", &arguments.small_cells,
      "Of --algorithm cell-projection, cells that cover fewer than two pixels' centres: "
      "sampled: exact where a ray passes them; splatted: spread over 3 x 3 pixels",
      {.choices = choices_of({render::SmallCells::sampled, render::SmallCells::splatted}),
       .shows_default = true});
}

}  // namespace haarlight::apps
