// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight render volume SCENE.toml -o PICTURE`: the exact picture of a medium in a mesh of cells.

#include "apps/haarlight/render_volume.h"

#include <algorithm>
#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "apps/haarlight/render_scene.h"
#include "apps/haarlight/volume_comparison.h"
#include "core/npy.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "relight/pipeline/display_exposure.h"
#include "render/volume/volume_ray_caster.h"

namespace haarlight::apps {

namespace {

constexpr double kShownFraction = 0.98;  ///< of the values of a .png, not clipped

struct VolumeArguments {
  std::string scene;
  std::string output;
  std::string float64;
  std::vector<int> size;
  double max_error = 0.0;
  render::VolumeMode mode = render::VolumeMode::exact;
  std::optional<int> points;
  std::optional<double> piece_depth;
  std::string comparison;
  std::optional<double> exposure;
};

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
  if (!arguments.comparison.empty() && mode == VolumeMode::exact &&
      arguments.max_error == 0.0) {
    throw Error("--compare tells what a picture is off by; this is the exact one", "--compare",
                "give --mode or --max-error, or leave it out", ExitCode::usage);
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
  return scene;
}

void require_volume_outputs(const VolumeArguments& arguments, bool force) {
  require_outputs(arguments.output, arguments.comparison, "--compare", force);
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
  const std::uint64_t n_films = arguments.comparison.empty() ? 2 : 4;  // one and its numbers
  const std::uint64_t bytes =
      render::VolumeRayCaster::bytes_needed(scene) * (n_films / 2) +
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

void report_rule(const render::RuleCounts& counts, const VolumeArguments& arguments,
                 Report& report) {
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
}

/// The exact picture too, and what the other is off by.
void compare(const render::VolumeScene& scene, const render::Film& film,
             const VolumeArguments& arguments, const CommonOptions& common, double seconds,
             Report& report) {
  const render::VolumeRayCaster caster(scene, {});
  render::Film exact(scene.camera.width, scene.camera.height,
                     render::VolumeRayCaster::layers());
  render::RunOptions run;
  run.samples = 1;
  run.progress = common.progress();
  const double exact_seconds = render::run(caster, run, exact).seconds;
  const std::vector<double> values = doubles_of(film);
  const std::vector<double> truth = doubles_of(exact);
  const VolumeErrors errors = compare_pictures(
      values, truth, {scene.background[0], scene.background[1], scene.background[2]});
  const Image<float> off = difference_of(values, truth, film.width(), film.height());
  const float largest = *std::ranges::max_element(off.pixels());
  write_image(arguments.comparison, off.view(), largest > 0.0F ? 1.0 / largest : 1.0);
  report.add_detail("pixels_compared", errors.n_compared);
  report.add_detail("exact_seconds", exact_seconds);
  for (std::size_t k = 0; k < errors.channels.size(); ++k) {
    const ChannelErrors& of = errors.channels.at(k);
    const std::string_view name = VolumeErrors::kNames.at(k);
    report.add_achieved(fmt::format("mean_error_{}", name), of.mean);
    report.add_achieved(fmt::format("error_at_99_percent_{}", name), of.at_99);
    report.add_achieved(fmt::format("worst_error_{}", name), of.worst);
    fmt::print(
        "beside the exact picture, {}: off by {:.2g} in the mean, {:.2g} at 99 %, {:.2g} at "
        "worst\n",
        name, of.mean, of.at_99, of.worst);
  }
  fmt::print("its rays took {:.3f} s, the exact ones {:.3f} s\n", seconds, exact_seconds);
}

void print_rule(const render::VolumeRayCaster& caster, const VolumeArguments& arguments) {
  const render::RuleCounts counts = caster.counts().rule;
  const std::optional<double> bound = caster.error_bound();
  fmt::print("by {}: {} pieces, {} terms; {}\n", to_string(arguments.mode), counts.pieces,
             counts.terms,
             bound ? fmt::format("red, green and blue are off by {:.2g} at most", *bound)
                   : "no bound of its error is known: --compare measures it");
  if (counts.not_finite + counts.negative > 0) {
    fmt::print(
        "its formulas gave no number for {} segments (written: their mean colour times their "
        "opacity), and a negative weight for {}\n",
        counts.not_finite, counts.negative);
  }
}

ExitCode run_volume(const VolumeArguments& arguments, const CommonOptions& common,
                    Report& report) {
  report.add_input(arguments.scene);
  report.add_requested("max_error", arguments.max_error);
  check_mode(arguments);
  require_volume_outputs(arguments, common.force);
  const render::VolumeScene scene = read_scene_of(arguments);
  report.add_input(scene.mesh_file.string());
  if (!scene.solution_file.empty()) {
    report.add_input(scene.solution_file.string());
  }
  require_memory(scene, arguments, common);
  const render::VolumeRayCaster caster(scene, options_of(arguments));
  render::Film film(scene.camera.width, scene.camera.height, render::VolumeRayCaster::layers());
  render::RunOptions run;
  run.samples = 1;
  run.progress = common.progress();
  const render::RunResult result = render::run(caster, run, film);
  caster.require_no_overlap();
  write_pictures(film, arguments, report);
  report.set_bytes(std::filesystem::file_size(arguments.output));
  const render::VolumeCounts counts = caster.counts();
  report.add_achieved("left_out", caster.left_out());
  if (arguments.mode != render::VolumeMode::exact) {
    report_rule(counts.rule, arguments, report);
    if (const std::optional<double> bound = caster.error_bound()) {
      report.add_achieved("error_bound", *bound);
    }
  }
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
  fmt::print("{}: {} x {} pixels, {} cells; {} rays through {:.3g} million cells in {:.2f} s\n",
             arguments.output, film.width(), film.height(), scene.mesh.n_cells(), counts.rays,
             1e-6 * static_cast<double>(counts.cells),
             caster.prepare_seconds() + result.seconds);
  if (scene.check.n_non_planar_faces > 0) {
    const std::size_t n = scene.check.n_non_planar_faces;
    fmt::print("{} face{} not flat, by up to {:.2g} mm: drawn as two triangles each\n", n,
               n == 1 ? " is" : "s are", scene.check.largest_deviation);
  }
  if (counts.unresolved + counts.lost_points > 0) {
    fmt::print(
        "in badly formed cells the field is not known to rounding: {} stretches, {} points\n",
        counts.unresolved, counts.lost_points);
  }
  if (counts.opaque_rays > 0) {
    fmt::print("{} rays ended where no more than {:.2g} could come from behind\n",
               counts.opaque_rays, caster.left_out());
  }
  if (arguments.mode != render::VolumeMode::exact) {
    print_rule(caster, arguments);
  }
  if (!arguments.comparison.empty()) {
    compare(scene, film, arguments, common, result.seconds, report);
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
  verb.option("--max-error", &arguments->max_error,
              "End rays where no more than E, in units of the picture, can come from behind "
              "(default: 0, exact)",
              {.type = "E", .bounds = Bounds{0.0, 1e100}});
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
  verb.option("--exposure", &arguments->exposure,
              "Factor for a .png (default: 98 % of the values are not clipped)",
              {.bounds = Bounds{1e-9, 1e9}});
  verb.footer(
      "Example:\n  haarlight render volume configs/volumes/cube.toml -o mist.exr "
      "--float64 mist.npy\n  haarlight render volume configs/volumes/cube.toml -o "
      "approximate.exr --mode approximate --compare off.png");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_volume(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
