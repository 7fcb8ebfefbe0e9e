// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight correct SESSION -o FOLDER`: each light's fall-off, and the pictures without
/// it.

#include <fmt/format.h>

#include "apps/haarlight/develop_options.h"
#include "apps/haarlight/picture_notes.h"
#include "apps/haarlight/verb.h"
#include "core/files.h"
#include "core/picture/image_io.h"
#include "relight/shape/corrected_light.h"
#include "session/develop/develop.h"
#include "session/light_file.h"

namespace haarlight {

namespace {

namespace fs = std::filesystem;

struct CorrectArguments {
  std::string session;
  std::string out;
  std::string fall_off = "plane";
  std::string transfer;
  PlaneArguments plane;
};

ExitCode run_correct(const CorrectArguments& arguments, const CommonOptions& common,
                     Report& report) {
  report.add_input(arguments.session);
  report.add_asked("fall_off", arguments.fall_off);
  require_absent(arguments.out, common.force);
  const Session session = Session::open(arguments.session);
  const CaptureLights lights = capture_lights(session);
  if (!lights.are_near) {
    throw Error("only the lights' directions are known: fall-off needs their places",
                arguments.session, "import the capture with positions (--places positions)");
  }
  const PixelPoints pixels =
      pixel_points(session, arguments.plane.width_mm, arguments.plane.height_mm.value_or(0.0));
  const LightStack stack =
      develop(session, develop_options(session, common, arguments.transfer));
  const StackDims shape = stack.dims();
  const LightCorrection correction(
      lights.near, pixels, shape.width, shape.height, pixels.plane_normal(),
      arguments.fall_off == "plane" ? FallOff::plane : FallOff::distance);
  const fs::path folder = arguments.out;
  fs::create_directories(folder / "fall-off");
  std::vector<std::string> names;
  const std::vector<Eigen::Vector3d> directions = picture_directions(session);
  double least = 1.0;
  std::uint64_t bytes = 0;
  Progress progress("correct", static_cast<std::size_t>(shape.n_lights), common.progress());
  for_each_light_image(stack, common.memory_bytes / 2, [&](int k, const Image<float>& picture) {
    const std::string name = fmt::format("light_{:04}.exr", k);
    const Image<float> map = correction.attenuation(k);
    for (const float value : map.pixels()) {
      least = std::min(least, double{value});
    }
    PictureNotes notes = notes_of(session.info());
    add_light(session.info(), k, notes);
    write_image(folder / "fall-off" / name, map.view(), 1.0, notes);
    add_direction(directions[static_cast<std::size_t>(k)], notes);  // far, once corrected
    write_image(folder / name, correction.corrected(picture.view(), k).view(), 1.0, notes);
    bytes += fs::file_size(folder / name) + fs::file_size(folder / "fall-off" / name);
    names.push_back(name);
    progress.advance();
  });
  write_file_atomically(folder / "lights.lp", format_lp(directions, names));
  report.add_reached("lights", std::int64_t{shape.n_lights});
  report.add_reached("least_fall_off", least);
  report.set_bytes(bytes);
  fmt::print("{}: {} pictures; the weakest corner had {:.3g} of its light's middle\n",
             arguments.out, shape.n_lights, least);
  return ExitCode::done;
}

}  // namespace

void add_correct(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<CorrectArguments>();
  Command verb =
      root.add_verb("correct", "Write each light's picture without the near light's fall-off");
  verb.option("SESSION", &arguments->session, "Session folder", {.is_required = true});
  verb.option("-o,--output", &arguments->out, "Folder to write",
              {.type = "FOLDER", .is_required = true});
  verb.option("--fall-off", &arguments->fall_off,
              "plane: distance, lobe and the reference plane's shading, so that a flat target "
              "comes out even; distance: without the shading",
              {.choices = {"plane", "distance"}, .shows_default = true});
  add_plane_options(verb, arguments->plane);
  add_transfer_option(verb, arguments->transfer);
  verb.footer(
      "Writes light_0000.exr ... (linear), lights.lp with their directions, and in fall-off/ "
      "each light's\nattenuation, 1 in the middle. `haarlight import` reads the folder "
      "again.\n\n"
      "Example:\n  haarlight correct rig.session --width-mm 400 -o rig.even");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_correct(*arguments, common, report);
  });
}

}  // namespace haarlight
