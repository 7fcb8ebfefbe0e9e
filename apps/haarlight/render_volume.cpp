// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight render volume SCENE.toml -o PICTURE`: the exact picture of a medium in a mesh of cells, or a
/// preview of it.

#include "apps/haarlight/render_volume.h"

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "apps/haarlight/render_scene.h"
#include "core/npy.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "relight/pipeline/display_exposure.h"
#include "render/volume/cell_projection.h"
#include "render/volume/projected_tetrahedra.h"
#include "render/volume/volume_ray_caster.h"

namespace haarlight::apps {

namespace {

constexpr double kShownFraction = 0.98;  ///< of the values of a .png, not clipped

/// Two ways to the same picture, and one to another.
enum class Algorithm : std::uint8_t { ray_casting, cell_projection, preview };
constexpr auto kAlgorithmWords =
    std::to_array<std::string_view>({"ray-casting", "cell-projection", "preview"});
constexpr std::span<const std::string_view> words_of(Algorithm) { return kAlgorithmWords; }

struct VolumeArguments {
  std::string scene;
  std::string output;
  std::string float64;
  std::vector<int> size;
  double max_error = 0.0;
  Algorithm algorithm = Algorithm::ray_casting;
  std::optional<render::Preview> preview;
  std::optional<render::PreviewOrder> order;
  render::SmallCells small_cells = render::SmallCells::sampled;
  std::optional<double> exposure;
};

render::PreviewOptions preview_options(const VolumeArguments& arguments) {
  render::PreviewOptions options;
  options.method = arguments.preview.value_or(options.method);
  options.order = arguments.order.value_or(options.order);
  return options;
}

/// What does not go together.
void check_preview(const VolumeArguments& arguments) {
  if (arguments.algorithm != Algorithm::preview && (arguments.preview || arguments.order)) {
    throw Error(fmt::format("--algorithm {} is no preview", to_string(arguments.algorithm)),
                arguments.preview ? "--preview" : "--order",
                "leave it out, or give --algorithm preview", ExitCode::usage);
  }
  if (arguments.algorithm != Algorithm::cell_projection &&
      arguments.small_cells == render::SmallCells::splatted) {
    throw Error(fmt::format("--algorithm {} makes no splats", to_string(arguments.algorithm)),
                "--small-cells", "leave it out, or give --algorithm cell-projection",
                ExitCode::usage);
  }
}

void check_preview(const render::VolumeScene& scene, const VolumeArguments& arguments) {
  if (arguments.algorithm == Algorithm::preview && !scene.contours.empty()) {
    throw Error("previews draw no contours", arguments.scene,
                "take its [[contour]] tables out, or leave out --algorithm preview",
                ExitCode::usage);
  }
}

render::VolumeScene read_scene_of(const VolumeArguments& arguments) {
  render::VolumeScene scene = render::read_volume_scene(arguments.scene);
  if (!arguments.size.empty()) {
    scene.optics.pixel_mm *= static_cast<double>(scene.camera.width) / arguments.size[0];
    scene.camera = render::resized(scene.camera, arguments.size[0], arguments.size[1]);
  }
  return scene;
}

void require_volume_outputs(const VolumeArguments& arguments, bool force) {
  require_outputs(arguments.output, "", "", force);
  if (!arguments.float64.empty()) {
    if (!has_ending(arguments.float64, ".npy")) {
      throw Error("no name of a NumPy file", arguments.float64, "end it in .npy",
                  ExitCode::usage);
    }
    require_absent(arguments.float64, force);
  }
}

void require_memory(const render::VolumeScene& scene, const VolumeArguments& arguments,
                    const CommonOptions& common) {
  const auto of_algorithm = [&] {
    switch (arguments.algorithm) {
      case Algorithm::cell_projection:
        return render::CellProjection::bytes_needed(scene, arguments.small_cells);
      case Algorithm::preview:
        return render::ProjectedTetrahedra::bytes_needed(scene,
                                                         preview_options(arguments).order);
      default:
        return render::VolumeRayCaster::bytes_needed(scene);
    }
  };
  const std::uint64_t bytes =
      of_algorithm() + 2 * render::Film::bytes_needed(scene.camera.width, scene.camera.height,
                                                      render::VolumeRayCaster::layers());
  if (bytes > common.memory_bytes) {
    constexpr std::uint64_t kMega = 1'000'000;
    throw Error(fmt::format("{} cells and {} x {} pixels need {} MB; --memory allows {}",
                            scene.mesh.n_cells(), scene.camera.width, scene.camera.height,
                            bytes / kMega, common.memory_bytes / kMega),
                arguments.scene, "give a smaller --size, or more --memory", ExitCode::usage);
  }
}

/// R, G, B and the opacity of each pixel, row by row.
std::vector<double> doubles_of(const render::Film& film) {
  constexpr std::size_t kChannels = 4;
  const auto width = static_cast<std::size_t>(film.width());
  std::vector<double> values(kChannels * width * static_cast<std::size_t>(film.height()));
  const std::vector<std::shared_ptr<const render::FilmTile>> tiles = film.tiles();
  for (const std::shared_ptr<const render::FilmTile>& tile : tiles) {
    const render::Tile& area = tile->area();
    const double* sums = tile->sums().data();
    for (int y = area.y0; y < area.y1; ++y) {
      for (int x = area.x0; x < area.x1; ++x, sums += kChannels) {
        std::copy_n(sums, kChannels,
                    values.begin() + static_cast<std::ptrdiff_t>(
                                         kChannels * (static_cast<std::size_t>(y) * width +
                                                      static_cast<std::size_t>(x))));
      }
    }
  }
  return values;
}

void write_pictures(const render::Film& film, const VolumeArguments& arguments,
                    Report& report) {
  using render::VolumeRayCaster;
  const Image<float> light = film.mean(VolumeRayCaster::kLight);
  const Image<float> opacity = film.mean(VolumeRayCaster::kOpacity);
  const std::string preview = preview_of(arguments.output);
  double exposure = 1.0;
  if (!preview.empty() || has_ending(arguments.output, ".png")) {
    const std::span<const float> values = light.pixels();
    exposure = arguments.exposure.value_or(
        relight::display_exposure({values.begin(), values.end()}, kShownFraction));
  }
  const std::array layers = {PictureLayer{.channels = {"A"}, .image = opacity.view()}};
  write_image(arguments.output, light.view(), exposure, {}, layers);
  if (!preview.empty()) {
    write_image(preview, light.view(), exposure);
  }
  if (!arguments.float64.empty()) {
    const std::array shape = {static_cast<std::size_t>(film.height()),
                              static_cast<std::size_t>(film.width()), std::size_t{4}};
    write_npy(arguments.float64, shape, doubles_of(film));
  }
  report.add_detail("exposure", exposure);
}

/// What both ways tell of cells whose fields are not known to rounding, and of faces.
void tell_of_mesh(const render::VolumeScene& scene, std::uint64_t n_unresolved,
                  std::uint64_t n_lost, Report& report) {
  report.add_detail("faces_not_flat",
                    static_cast<std::int64_t>(scene.check.n_non_planar_faces));
  report.add_detail("lost_points", static_cast<std::int64_t>(n_lost));
  report.add_detail("unresolved", static_cast<std::int64_t>(n_unresolved));
  if (scene.check.n_non_planar_faces > 0) {
    const std::size_t n = scene.check.n_non_planar_faces;
    fmt::print("{} face{} not flat, by up to {:.2g} mm: drawn as two triangles each\n", n,
               n == 1 ? " is" : "s are", scene.check.largest_deviation);
  }
  if (n_unresolved + n_lost > 0) {
    fmt::print(
        "in badly formed cells the field is not known to rounding: {} stretches, {} points\n",
        n_unresolved, n_lost);
  }
}

render::RunResult render_film(const render::TileRenderer& renderer, const CommonOptions& common,
                              render::Film& film) {
  render::RunOptions run;
  run.samples = 1;
  run.progress = common.progress();
  return render::run(renderer, run, film);
}

ExitCode project_cells(const render::VolumeScene& scene, const VolumeArguments& arguments,
                       const CommonOptions& common, Report& report) {
  const render::CellProjection projection(scene, arguments.small_cells);
  const render::VisibilityOrder& order = projection.order();
  render::Film film(scene.camera.width, scene.camera.height, render::VolumeRayCaster::layers());
  const render::RunResult result = render_film(projection, common, film);
  write_pictures(film, arguments, report);
  report.set_bytes(std::filesystem::file_size(arguments.output));
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
  fmt::print("{}: {} x {} pixels, {} cells; {:.3g} million stretches in {:.2f} s\n",
             arguments.output, film.width(), film.height(), scene.mesh.n_cells(),
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
    fmt::print("{} cells smaller than two pixels are splats: not exact\n",
               projection.n_splats());
  }
  tell_of_mesh(scene, counts.unresolved, counts.lost_points, report);
  if (counts.violations > 0) {
    fmt::print(stderr, "{}: {} stretches were drawn out of order, the picture is wrong: {}\n",
               arguments.output, counts.violations, projection.violation());
    return ExitCode::target_missed;
  }
  return ExitCode::done;
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
    fmt::print("{} cells hide parts of each other in rings, and are drawn whole\n",
               counts.split_cells);
  }
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
  write_pictures(film, arguments, report);
  report.set_bytes(std::filesystem::file_size(arguments.output));
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
  fmt::print("{}: {} x {} pixels, {} cells in {:.2f} s\n", arguments.output, film.width(),
             film.height(), scene.mesh.n_cells(),
             mesh.prepare_seconds + preview.view_seconds() + result.seconds);
  tell_of_preview(scene, options, preview);
  return ExitCode::done;
}

ExitCode cast_rays(const render::VolumeScene& scene, const VolumeArguments& arguments,
                   const CommonOptions& common, Report& report) {
  const render::VolumeRayCaster caster(scene, {.max_error = arguments.max_error});
  render::Film film(scene.camera.width, scene.camera.height, render::VolumeRayCaster::layers());
  const render::RunResult result = render_film(caster, common, film);
  caster.require_no_overlap();
  write_pictures(film, arguments, report);
  report.set_bytes(std::filesystem::file_size(arguments.output));
  const render::VolumeCounts counts = caster.counts();
  report.add_achieved("left_out", caster.left_out());
  report.add_detail("cells_of_mesh", static_cast<std::int64_t>(scene.mesh.n_cells()));
  report.add_detail("rays", static_cast<std::int64_t>(counts.rays));
  report.add_detail("cells_passed", static_cast<std::int64_t>(counts.cells));
  report.add_detail("segments", static_cast<std::int64_t>(counts.segments));
  report.add_detail("exact_sides", static_cast<std::int64_t>(counts.exact_sides));
  report.add_detail("opaque_rays", static_cast<std::int64_t>(counts.opaque_rays));
  report.add_detail("prepare_seconds", caster.prepare_seconds());
  report.add_detail("render_seconds", result.seconds);
  fmt::print("{}: {} x {} pixels, {} cells; {} rays through {:.3g} million cells in {:.2f} s\n",
             arguments.output, film.width(), film.height(), scene.mesh.n_cells(), counts.rays,
             1e-6 * static_cast<double>(counts.cells),
             caster.prepare_seconds() + result.seconds);
  tell_of_mesh(scene, counts.unresolved, counts.lost_points, report);
  if (counts.opaque_rays > 0) {
    fmt::print("{} rays ended where no more than {:.2g} could come from behind\n",
               counts.opaque_rays, caster.left_out());
  }
  return ExitCode::done;
}

ExitCode run_volume(const VolumeArguments& arguments, const CommonOptions& common,
                    Report& report) {
  report.add_input(arguments.scene);
  report.add_requested("max_error", arguments.max_error);
  report.add_requested("algorithm", std::string(to_string(arguments.algorithm)));
  if (arguments.max_error > 0.0 && arguments.algorithm != Algorithm::ray_casting) {
    throw Error(fmt::format("--algorithm {} ends no rays", to_string(arguments.algorithm)),
                "--max-error", "leave it out, or give --algorithm ray-casting",
                ExitCode::usage);
  }
  check_preview(arguments);
  require_volume_outputs(arguments, common.force);
  const render::VolumeScene scene = read_scene_of(arguments);
  report.add_input(scene.mesh_file.string());
  if (!scene.solution_file.empty()) {
    report.add_input(scene.solution_file.string());
  }
  check_preview(scene, arguments);
  require_memory(scene, arguments, common);
  switch (arguments.algorithm) {
    case Algorithm::cell_projection:
      return project_cells(scene, arguments, common, report);
    case Algorithm::preview:
      return draw_preview(scene, arguments, common, report);
    default:
      return cast_rays(scene, arguments, common, report);
  }
}

}  // namespace

void add_render_volume(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<VolumeArguments>();
  Command verb = root.add_verb("volume", "The exact picture of a medium in a mesh of cells");
  verb.option("SCENE", &arguments->scene,
              "Scene file with a [mesh], a [density] and a [camera]",
              {.type = "SCENE.toml", .is_required = true});
  verb.option("-o,--output", &arguments->output,
              "Picture to write: .exr linear, with the opacity as channel A; .tif linear; .png "
              "for display",
              {.type = "PICTURE", .is_required = true});
  verb.option(
      "--float64", &arguments->float64,
      "Also write red, green, blue and opacity in double precision, for NumPy: an array "
      "of (height, width, 4)",
      {.type = "FILE.npy"});
  verb.option("--size", &arguments->size, "Picture size (default: that of the [camera])",
              {.type = "WxH", .bounds = Bounds{1, 1 << 16}, .delimiter = 'x', .count = 2});
  verb.option(
      "--algorithm", &arguments->algorithm,
      "How the picture is made: ray-casting: each ray from cell to cell; "
      "cell-projection: cell by cell, in the order in which they are seen. Both are exact. "
      "preview: approximate, by projected tetrahedra",
      {.choices =
           choices_of({Algorithm::ray_casting, Algorithm::cell_projection, Algorithm::preview}),
       .shows_default = true});
  verb.option(
      "--preview", &arguments->preview,
      "Of --algorithm preview: m0: opacity is interpolated; m1: its exponent is (the "
      "default); m3: as m1, and exact at the thickest point of each tetrahedron",
      {.choices = choices_of({render::Preview::m0, render::Preview::m1, render::Preview::m3})});
  verb.option(
      "--order", &arguments->order,
      "Of --algorithm preview: centroid: by the tetrahedra's centroids (the default); "
      "exact: in which the cells are seen",
      {.choices = choices_of({render::PreviewOrder::centroid, render::PreviewOrder::exact})});
  verb.option(
      "--small-cells", &arguments->small_cells,
      "Of --algorithm cell-projection, cells that cover fewer than two pixels' centres: "
      "sampled: exact where a ray passes them; splatted: spread over 3 x 3 pixels",
      {.choices = choices_of({render::SmallCells::sampled, render::SmallCells::splatted}),
       .shows_default = true});
  verb.option("--max-error", &arguments->max_error,
              "End rays where no more than E, in units of the picture, can come from behind "
              "(default: 0, exact)",
              {.type = "E", .bounds = Bounds{0.0, 1e100}});
  verb.option("--exposure", &arguments->exposure,
              "Factor for a .png (default: 98 % of the values are not clipped)",
              {.bounds = Bounds{1e-9, 1e9}});
  verb.footer(
      "Example:\n  haarlight render volume configs/volumes/cube.toml -o mist.exr "
      "--float64 mist.npy");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_volume(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
