// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/render_join.h"

#include <algorithm>
#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "apps/haarlight/render_scene.h"
#include "apps/haarlight/surface_picture.h"
#include "apps/haarlight/volume_picture.h"
#include "haarlight/core/error.h"
#include "render/film/film_file.h"
#include "render/surface/surface_layers.h"
#include "render/volume/volume_ray_caster.h"

namespace haarlight::apps {

namespace {

struct JoinArguments {
  std::vector<std::string> films;
  VolumePictureNames names;
  std::string error_picture;
};

/// Samples of the pixels that have fewest and most. @throws Error  some have none
std::pair<std::uint32_t, std::uint32_t> samples_of(const render::Film& film,
                                                   const std::string& path) {
  std::uint32_t least = std::numeric_limits<std::uint32_t>::max();
  std::uint32_t most = 0;
  std::size_t n_missing = 0;
  for (std::size_t i = 0; i < film.n_tiles(); ++i) {
    least = std::min(least, film.samples_of(i));
    most = std::max(most, film.samples_of(i));
    n_missing += film.samples_of(i) == 0 ? 1 : 0;
  }
  if (n_missing > 0) {
    throw Error(
        fmt::format("parts of the picture are missing: {} of {} tiles", n_missing,
                    film.n_tiles()),
        path,
        "name the films of all parts, 1/N to N/N; one that was interrupted goes on by its "
        "own command");
  }
  return {least, most};
}

ExitCode join_surface(const render::FilmFile& whole, const JoinArguments& arguments,
                      Report& report) {
  if (!arguments.names.float64.empty()) {
    throw Error("the picture of surfaces is not written in double precision", "--float64",
                "leave it out: it is for films of haarlight render volume", ExitCode::usage);
  }
  const render::Film& film = *whole.film;
  const PictureWindow window = window_of(whole.settings, arguments.films.front());
  const auto [least, most] = samples_of(film, arguments.films.front());
  if (least < 2 && !arguments.error_picture.empty()) {
    throw Error("one sample has no standard error", "--error", "render with --spp 2 or more",
                ExitCode::usage);
  }
  const render::FilmError error = film.error(render::SurfaceLayer::kRadiance);
  report.add_achieved("relative_l2", error.relative_l2);
  report.add_achieved("samples_per_pixel", std::int64_t{least});
  const std::string& output = arguments.names.output;
  report.add_detail("exposure",
                    write_surface_pictures(film, window, least, output, arguments.error_picture,
                                           arguments.names.exposure));
  report.set_bytes(std::filesystem::file_size(output));
  fmt::print("{}: {} x {} pixels, {}, standard error {:.2g} of the picture (L2)\n", output,
             film.width(), film.height(), samples_words(least, most), error.relative_l2);
  return ExitCode::done;
}

ExitCode join_volume(const render::FilmFile& whole, const JoinArguments& arguments,
                     Report& report) {
  if (!arguments.error_picture.empty()) {
    throw Error("the picture of a volume has no standard error", "--error",
                "leave it out: no samples are drawn", ExitCode::usage);
  }
  const render::Film& film = *whole.film;
  static_cast<void>(samples_of(film, arguments.films.front()));
  const VolumeFilmFacts facts = facts_of(film);
  if (facts.overlaps > 0) {
    throw Error(
        fmt::format("cells overlap, in pixel ({}, {})", facts.overlap_x, facts.overlap_y),
        arguments.films.front(),
        "render volume tells their numbers: mend the mesh, and render all parts again");
  }
  const double left_out = left_out_of(whole.settings, facts);
  report.add_achieved("left_out", left_out);
  const std::string& output = arguments.names.output;
  report.add_detail("exposure", write_volume_pictures(film, arguments.names));
  report.set_bytes(std::filesystem::file_size(output));
  fmt::print("{}: {} x {} pixels\n", output, film.width(), film.height());
  tell_doubts(facts, left_out);
  return ExitCode::done;
}

ExitCode run_join(const JoinArguments& arguments, const CommonOptions& common, Report& report) {
  require_outputs(arguments.names.output, arguments.error_picture, "--error", common.force);
  require_volume_outputs(arguments.names, common.force);
  render::FilmFile whole;
  for (const std::string& path : arguments.films) {
    report.add_input(path);
    render::FilmFile part = render::read_film(path, common.memory_bytes / 2);
    if (whole.film == nullptr) {
      whole = std::move(part);
    } else {
      join_film(part, path, whole);
    }
  }
  if (whole.film->layers() == render::VolumeRayCaster::layers()) {
    return join_volume(whole, arguments, report);
  }
  if (whole.film->layers() == render::surface_layers(true) ||
      whole.film->layers() == render::surface_layers(true, true)) {
    return join_surface(whole, arguments, report);
  }
  throw Error("a film of another kind of render", arguments.films.front(),
              "name films of haarlight render surface or volume");
}

}  // namespace

void add_render_join(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<JoinArguments>();
  Command verb = root.add_verb("join", "Make a picture of the films of its parts");
  verb.option("FILM", &arguments->films, "Films of haarlight render surface or volume --film",
              {.type = "FILM", .is_required = true});
  verb.option("-o,--output", &arguments->names.output,
              "Picture to write: .exr linear, with further channels as without parts; .tif "
              "linear; .png for display",
              {.type = "PICTURE", .is_required = true});
  verb.option("--error", &arguments->error_picture,
              "Of surfaces: also write the standard error of each pixel, as a picture",
              {.type = "PICTURE"});
  verb.option("--float64", &arguments->names.float64,
              "Of a volume: also write its numbers in double precision, for NumPy",
              {.type = "FILE.npy"});
  add_exposure_option(verb, arguments->names.exposure);
  verb.footer("Example:\n  haarlight render join first.film second.film -o joined.exr");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_join(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
