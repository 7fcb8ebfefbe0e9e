// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight render volume SCENE.toml -o PICTURE`: the exact picture of a medium in a mesh of cells.

#include "apps/haarlight/render_volume.h"

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "apps/haarlight/end_signals.h"
#include "apps/haarlight/render_film.h"
#include "apps/haarlight/render_scene.h"
#include "apps/haarlight/volume_picture.h"
#include "apps/program_version.h"
#include "render/volume/volume_hash.h"
#include "render/volume/volume_ray_caster.h"

namespace haarlight::apps {

namespace {

struct VolumeArguments {
  std::string scene;
  VolumePictureNames names;
  FilmArguments kept;
  std::vector<int> size;
  double max_error = 0.0;
  std::optional<double> seconds;
};

render::VolumeScene read_scene_of(const VolumeArguments& arguments) {
  render::VolumeScene scene = render::read_volume_scene(arguments.scene);
  if (!arguments.size.empty()) {
    scene.optics.pixel_mm *= static_cast<double>(scene.camera.width) / arguments.size[0];
    scene.camera = render::resized(scene.camera, arguments.size[0], arguments.size[1]);
  }
  require_sizes(scene);
  return scene;
}

void require_memory(const render::VolumeScene& scene, const VolumeArguments& arguments,
                    const CommonOptions& common) {
  const std::uint64_t bytes =
      render::VolumeRayCaster::bytes_needed(scene) +
      2 * render::Film::bytes_needed(scene.camera.width, scene.camera.height,
                                     render::VolumeRayCaster::layers());
  if (bytes > common.memory_bytes) {
    constexpr std::uint64_t kMega = 1'000'000;
    throw Error(fmt::format("{} cells and {} x {} pixels need {} MB; --memory allows {}",
                            scene.mesh.n_cells(), scene.camera.width, scene.camera.height,
                            bytes / kMega, common.memory_bytes / kMega),
                arguments.scene, "give a smaller --size, or more --memory", ExitCode::usage);
  }
}

/// All that a pixel's values depend on.
render::RenderSettings settings_of(const VolumeArguments& arguments,
                                   const render::VolumeScene& scene, const render::Part& part) {
  const render::VolumeHashes hashes = hashes_of(scene);
  return {{"program", program_version()},
          {"render", "volume"},
          {"mesh", hashes.mesh},
          {"looks", hashes.looks},
          {"behind", hashes.behind},
          {"camera", hashes.camera},
          {kMaxErrorSetting, fmt::format("{}", arguments.max_error)},
          {"parts", std::to_string(part.n_parts)}};
}

/// An overlap that an earlier run has met: its tile again, for the cells' numbers.
void require_no_kept_overlap(const render::VolumeRayCaster& caster, const render::Film& film) {
  if (facts_of(film).overlaps == 0) {
    return;
  }
  for (std::size_t i = 0; i < film.n_tiles(); ++i) {
    if (film.samples_of(i) != 0) {
      render::FilmTile tile(film.area_of(i), film.layers());
      static_cast<void>(caster.render_tile({.first = 0, .end = 1}, tile));
    }
  }
  caster.require_no_overlap();
}

void add_counts(const render::VolumeScene& scene, const render::VolumeRayCaster& caster,
                const render::RunResult& result, Report& report) {
  const render::VolumeCounts counts = caster.counts();
  report.add_detail("cells_of_mesh", static_cast<std::int64_t>(scene.mesh.n_cells()));
  report.add_detail("rays", static_cast<std::int64_t>(counts.rays));
  report.add_detail("cells_passed", static_cast<std::int64_t>(counts.cells));
  report.add_detail("segments", static_cast<std::int64_t>(counts.segments));
  report.add_detail("exact_sides", static_cast<std::int64_t>(counts.exact_sides));
  report.add_detail("faces_not_flat",
                    static_cast<std::int64_t>(scene.check.n_non_planar_faces));
  report.add_detail("lost_points", static_cast<std::int64_t>(counts.lost_points));
  report.add_detail("unresolved", static_cast<std::int64_t>(counts.unresolved));
  report.add_detail("opaque_rays", static_cast<std::int64_t>(counts.opaque_rays));
  report.add_detail("prepare_seconds", caster.prepare_seconds());
  report.add_detail("render_seconds", result.seconds);
}

render::RunOptions run_options(const VolumeArguments& arguments, const CommonOptions& common) {
  render::RunOptions options;
  options.samples = 1;
  options.least_samples = 0;
  options.seconds = arguments.seconds.value_or(options.seconds);
  options.keep_seconds = arguments.kept.keep_seconds.value_or(options.keep_seconds);
  options.part = part_of(arguments.kept, arguments.names.output);
  options.progress = common.progress();
  return options;
}

ExitCode run_volume(const VolumeArguments& arguments, const CommonOptions& common,
                    Report& report) {
  report.add_input(arguments.scene);
  report.add_requested("max_error", arguments.max_error);
  render::RunOptions run = run_options(arguments, common);
  require_film_words(arguments.kept, arguments.names.output, false);
  require_volume_outputs(arguments.names, common.force);
  const render::VolumeScene scene = read_scene_of(arguments);
  report.add_input(scene.mesh_file.string());
  if (!scene.solution_file.empty()) {
    report.add_input(scene.solution_file.string());
  }
  if (!scene.background.file.empty()) {
    report.add_input(scene.background.file.string());
  }
  if (scene.surfaces) {
    report.add_input(scene.surfaces->file.string());
  }
  require_memory(scene, arguments, common);
  const render::RenderSettings settings = settings_of(arguments, scene, run.part);
  auto film = std::make_unique<render::Film>(scene.camera.width, scene.camera.height,
                                             render::VolumeRayCaster::layers());
  std::optional<FilmKeeper> keeper;
  std::optional<EndSignals> signals;
  if (!arguments.kept.film.empty()) {
    signals.emplace();  // before there is a film: from then on it can go on
    keeper.emplace(arguments.kept.film, run.part, settings, common.memory_bytes, film);
    run.keep = [&keeper] { keeper->keep(); };
    run.is_stopped = EndSignals::have_come;
  }
  const std::size_t n_before = facts_of(*film).n_rendered;
  const render::VolumeRayCaster caster(scene, {.max_error = arguments.max_error});
  require_no_kept_overlap(caster, *film);
  const render::RunResult result = render::run(caster, run, *film);
  if (keeper) {
    keeper->keep_last();
  }
  caster.require_no_overlap();
  const VolumeFilmFacts facts = facts_of(*film);
  const double left_out = facts.ended_pixels > 0 ? caster.left_out() : 0.0;
  const std::size_t n_tiles = tiles_of(*film, run.part);
  const std::size_t n_missing = n_tiles - facts.n_rendered;
  report.add_achieved("left_out", left_out);
  report.add_achieved("missing_tiles", static_cast<std::int64_t>(n_missing));
  report.add_achieved("ended_by", std::string(to_string(result.end)));
  add_counts(scene, caster, result, report);
  const std::string tiles = fmt::format("{} of {} tiles rendered", facts.n_rendered, n_tiles);
  if (result.end == render::RunEnd::stopped) {
    fmt::print("{}: interrupted, {}; the same command goes on\n", arguments.kept.film, tiles);
    return ExitCode::interrupted;
  }
  const std::string& made =
      arguments.names.output.empty() ? arguments.kept.film : arguments.names.output;
  if (!arguments.names.output.empty()) {
    report.add_detail("exposure", write_volume_pictures(*film, arguments.names));
  }
  report.set_bytes(std::filesystem::file_size(made));
  const render::VolumeCounts counts = caster.counts();
  fmt::print("{}: {} x {} pixels, {} cells; {} rays through {:.3g} million cells in {:.2f} s\n",
             made, film->width(), film->height(), scene.mesh.n_cells(), counts.rays,
             1e-6 * static_cast<double>(counts.cells),
             caster.prepare_seconds() + result.seconds);
  if (n_before > 0) {
    fmt::print("{} of {} tiles had been in {}\n", n_before, n_tiles, arguments.kept.film);
  }
  if (scene.check.n_non_planar_faces > 0) {
    const std::size_t n = scene.check.n_non_planar_faces;
    fmt::print("{} face{} not flat, by up to {:.2g} mm: drawn as two triangles each\n", n,
               n == 1 ? " is" : "s are", scene.check.largest_deviation);
  }
  tell_doubts(facts, left_out);
  if (n_missing > 0) {
    const bool has_output = !arguments.names.output.empty();
    fmt::print("the time ended it: {}{}; {}\n", tiles,
               has_output ? ", the others are NaN in the picture, hatched in a .png" : "",
               arguments.kept.film.empty()
                   ? "with --film FILE it could go on"
                   : (has_output ? "with --force the same command goes on"
                                 : "the same command goes on"));
    return ExitCode::target_missed;
  }
  return ExitCode::done;
}

}  // namespace

void add_render_volume(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<VolumeArguments>();
  Command verb = root.add_verb("volume", "The exact picture of a medium in a mesh of cells");
  verb.option("SCENE", &arguments->scene,
              "Scene file with a [mesh], a [density] and a [camera]",
              {.type = "SCENE.toml", .is_required = true});
  verb.option("-o,--output", &arguments->names.output,
              "Picture to write: .exr linear, with opacity and depth as channels A and Z; .tif "
              "linear; .png for display",
              {.type = "PICTURE"});
  verb.option(
      "--float64", &arguments->names.float64,
      "Also write red, green, blue and opacity in double precision, for NumPy: an array "
      "of (height, width, 4)",
      {.type = "FILE.npy"});
  verb.option("--size", &arguments->size, "Picture size (default: that of the [camera])",
              {.type = "WxH", .bounds = Bounds{1, 1 << 16}, .delimiter = 'x', .count = 2});
  verb.option("--max-error", &arguments->max_error,
              "End rays where no more than E, in units of the picture, can come from behind "
              "(default: 0, exact)",
              {.type = "E", .bounds = Bounds{0.0, 1e100}});
  verb.option("--seconds", &arguments->seconds,
              "End after T seconds; what is not rendered then is told, and exit code 1",
              {.type = "T", .bounds = Bounds{0.01}});
  add_exposure_option(verb, arguments->names.exposure);
  add_film_options(verb, arguments->kept, "what is rendered");
  verb.footer(
      "Example:\n  haarlight render volume configs/volumes/cube.toml -o mist.exr "
      "--float64 mist.npy");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_volume(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
