// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight render volume SCENE.toml -o PICTURE`: the exact picture of a medium in a mesh of cells.

#include "apps/haarlight/render_volume.h"

#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include <fmt/format.h>

#include "apps/haarlight/end_signals.h"
#include "apps/haarlight/render_cells.h"
#include "apps/haarlight/render_film.h"
#include "apps/haarlight/render_scene.h"
#include "apps/haarlight/volume_comparison.h"
#include "apps/haarlight/volume_picture.h"
#include "apps/program_version.h"
#include "core/counted.h"
#include "render/volume/volume_hash.h"
#include "render/volume/volume_ray_caster.h"

namespace haarlight::apps {

namespace {

/// What does not go together.
void check_mode(const VolumeArguments& arguments) {
  using render::VolumeMode;
  const VolumeMode mode = arguments.mode;
  if (mode != VolumeMode::gauss && (arguments.points || arguments.piece_depth)) {
    throw Error(fmt::format("--mode {} has no points of its own", to_string(mode)),
                arguments.points ? "--points" : "--piece-depth",
                "leave it out, or give --mode gauss", ExitCode::usage);
  }
  if (mode != VolumeMode::exact && mode != VolumeMode::series && arguments.max_error > 0.0) {
    throw Error(fmt::format("--mode {} keeps no error that it is told", to_string(mode)),
                "--max-error", "leave it out, or give --mode exact or series", ExitCode::usage);
  }
  if (mode != VolumeMode::exact && !arguments.kept.film.empty()) {
    throw Error(fmt::format("--mode {} is no render that goes on: the bound of its error is "
                            "that of one run",
                            to_string(mode)),
                "--film", "leave it out, or give --mode exact", ExitCode::usage);
  }
  if (!arguments.comparison.empty() && arguments.names.output.empty()) {
    throw Error("a comparison without its picture", "--compare", "give -o PICTURE too",
                ExitCode::usage);
  }
  if (!arguments.comparison.empty() && arguments.algorithm == Algorithm::ray_casting &&
      mode == VolumeMode::exact && arguments.max_error == 0.0) {
    throw Error("--compare tells what a picture is off by; this is the exact one", "--compare",
                "give --mode, --max-error or --algorithm, or leave it out", ExitCode::usage);
  }
}

render::VolumeOptions options_of(const VolumeArguments& arguments) {
  render::VolumeOptions options{.max_error = arguments.max_error,
                                .rule = {.mode = arguments.mode}};
  options.rule.points = arguments.points.value_or(options.rule.points);
  options.rule.piece_depth = arguments.piece_depth.value_or(options.rule.piece_depth);
  return options;
}

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
  const std::uint64_t n_films = arguments.comparison.empty() ? 2 : 4;  // one and its numbers
  const std::uint64_t bytes =
      bytes_of_algorithm(scene, arguments) * (n_films / 2) +
      n_films * render::Film::bytes_needed(scene.camera.width, scene.camera.height,
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
  report.add_detail("lost_points", static_cast<std::int64_t>(counts.lost_points));
  report.add_detail("unresolved", static_cast<std::int64_t>(counts.unresolved));
  report.add_detail("moved_rays", static_cast<std::int64_t>(counts.moved_rays));
  report.add_detail("undecided_rays", static_cast<std::int64_t>(counts.undecided_rays));
  report.add_detail("opaque_rays", static_cast<std::int64_t>(counts.opaque_rays));
  report.add_detail("prepare_seconds", caster.prepare_seconds());
  report.add_detail("render_seconds", result.seconds);
}

void report_rule(const render::VolumeRayCaster& caster, const VolumeArguments& arguments,
                 Report& report) {
  const render::RuleCounts counts = caster.counts().rule;
  report.add_requested("mode", std::string(to_string(arguments.mode)));
  if (arguments.mode == render::VolumeMode::gauss) {
    const render::VolumeRule rule = options_of(arguments).rule;
    report.add_requested("points", std::int64_t{rule.points});
    report.add_requested("piece_depth", rule.piece_depth);
  }
  report.add_detail("pieces", static_cast<std::int64_t>(counts.pieces));
  report.add_detail("terms", static_cast<std::int64_t>(counts.terms));
  report.add_detail("not_finite", static_cast<std::int64_t>(counts.not_finite));
  report.add_detail("negative", static_cast<std::int64_t>(counts.negative));
  if (const std::optional<double> bound = caster.error_bound()) {
    report.add_achieved("error_bound", *bound);
  }
}

void print_rule(const render::VolumeRayCaster& caster, const VolumeArguments& arguments) {
  const render::RuleCounts counts = caster.counts().rule;
  const std::optional<double> bound = caster.error_bound();
  fmt::print("by {}: {}, {}; {}\n", to_string(arguments.mode), counted(counts.pieces, "piece"),
             counted(counts.terms, "term"),
             bound ? fmt::format("red, green and blue are off by {:.2g} at most", *bound)
                   : "no bound of its error is known: --compare measures it");
  if (counts.not_finite + counts.negative > 0) {
    fmt::print(
        "its formulas gave no number for {} segments (written: their mean colour times their "
        "opacity), and a negative weight for {}\n",
        counts.not_finite, counts.negative);
  }
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

ExitCode cast_rays(const render::VolumeScene& scene, const VolumeArguments& arguments,
                   const CommonOptions& common, render::RunOptions run, Report& report) {
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
  const render::VolumeRayCaster caster(scene, options_of(arguments));
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
  if (arguments.mode != render::VolumeMode::exact) {
    report_rule(caster, arguments, report);
  }
  add_counts(scene, caster, result, report);
  const std::string tiles =
      fmt::format("{} of {} rendered", facts.n_rendered, counted(n_tiles, "tile"));
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
  fmt::print("{}: {} x {} pixels, {}; {} through {:.3g} million cells in {:.2f} s\n", made,
             film->width(), film->height(), counted(scene.mesh.n_cells(), "cell"),
             counted(counts.rays, "ray"), 1e-6 * static_cast<double>(counts.cells),
             caster.prepare_seconds() + result.seconds);
  if (n_before > 0) {
    fmt::print("{} of {} tiles had been in {}\n", n_before, n_tiles, arguments.kept.film);
  }
  tell_faces(scene, report);
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
  if (arguments.mode != render::VolumeMode::exact) {
    print_rule(caster, arguments);
  }
  if (!arguments.comparison.empty()) {
    compare_with_exact(scene, *film, arguments.comparison, common.progress(), result.seconds,
                       report);
  }
  return ExitCode::done;
}

ExitCode run_volume(const VolumeArguments& arguments, const CommonOptions& common,
                    Report& report) {
  report.add_input(arguments.scene);
  report.add_requested("algorithm", std::string(to_string(arguments.algorithm)));
  check_algorithm(arguments);
  report.add_requested("max_error", arguments.max_error);
  check_mode(arguments);
  const render::RunOptions run = run_options(arguments, common);
  require_film_words(arguments.kept, arguments.names.output, false);
  require_volume_outputs(arguments.names, common.force);
  if (!arguments.comparison.empty()) {
    require_outputs(arguments.names.output, arguments.comparison, "--compare", common.force);
  }
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
  check_preview(scene, arguments);
  require_memory(scene, arguments, common);
  switch (arguments.algorithm) {
    case Algorithm::cell_projection:
      return project_cells(scene, arguments, common, report);
    case Algorithm::projected_tetrahedra:
      return draw_preview(scene, arguments, common, report);
    case Algorithm::ray_casting:
      break;
  }
  return cast_rays(scene, arguments, common, run, report);
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
  add_algorithm_options(verb, *arguments);
  verb.option("--max-error", &arguments->max_error,
              "End rays where no more than E, in units of the picture, can come from behind "
              "(default: 0, exact)",
              {.type = "E", .bounds = Bounds{0.0, 1e100}});
  verb.option("--seconds", &arguments->seconds,
              "End after T seconds; what is not rendered then is told, and exit code 1",
              {.type = "T", .bounds = Bounds{0.01}});
  verb.option(
      "--mode", &arguments->mode,
      "exact; or, to be compared with it: gauss, --points on pieces of --piece-depth; series, "
      "with a guaranteed bound; paper, Dawson's integral as first published; approximate, "
      "mean colours of pieces; approximate-unsliced, of cells",
      {.shows_default = true});
  verb.option("--points", &arguments->points,
              "Of --mode gauss: points on each piece (default: 5)",
              {.type = "N", .bounds = Bounds{1, render::VolumeRule::kMostPoints}});
  verb.option("--piece-depth", &arguments->piece_depth,
              "Of --mode gauss: the largest optical depth of a piece (default: 0.5)",
              {.type = "TAU",
               .bounds = Bounds{render::VolumeRule::kLeastPieceDepth,
                                render::VolumeRule::kLargestPieceDepth}});
  verb.option("--compare", &arguments->comparison,
              "Also render the exact picture; tell the errors and draw them, in a .png so that "
              "the largest is white",
              {.type = "PICTURE"});
  add_exposure_option(verb, arguments->names.exposure);
  add_film_options(verb, arguments->kept, "what is rendered");
  verb.footer(
      "Example:\n  haarlight render volume configs/volumes/cube.toml -o mist.exr "
      "--float64 mist.npy\n  haarlight render volume configs/volumes/cube.toml -o "
      "approximate.exr --mode approximate --compare off.png");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_volume(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
