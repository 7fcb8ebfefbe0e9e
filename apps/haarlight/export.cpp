// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight export SESSION --lp|--dome|--transforms -o FILE`: what other programs read.

#include "haarlight/session/export.h"

#include <utility>

#include <fmt/format.h>

#include "apps/haarlight/options/develop_options.h"
#include "apps/haarlight/verb.h"
#include "core/counted.h"
#include "core/log.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/session/develop/develop.h"
#include "relight/pipeline/display_exposure.h"
#include "relight/pipeline/picture_notes.h"

namespace haarlight::apps {

namespace {

namespace fs = std::filesystem;

struct ExportArguments {
  std::string session;
  bool lp = false;
  bool dome = false;
  bool transforms = false;
  std::string out;
  std::string png;
  std::string exr;
  [[nodiscard]] bool is_developed() const { return !png.empty() || !exr.empty(); }
};

/// The exposure that puts the 99.9th percentile of all lights' values at white.
double choose_exposure(const LightStack& stack) {
  std::vector<float> sample;
  constexpr std::size_t kEvery = 97;  // a prime: no rhythm with pixels or lights
  for (int i = 0; i < stack.bands().n(); ++i) {
    const std::span<const float> values = stack.band(i);
    for (std::size_t at = 0; at < values.size(); at += kEvery) {
      sample.push_back(values[at]);
    }
  }
  return relight::display_exposure(sample, 0.999);
}

/// Develops and writes one picture per light; their names relative to the list's folder. Dark,
/// drift, flat field and exposures are in them.
std::vector<std::string> write_pictures(const session::Session& session,
                                        const ExportArguments& arguments,
                                        const CommonOptions& common) {
  const LightStack stack = session::develop(session, develop_options(session, common));
  const bool is_exr = !arguments.exr.empty();
  const double exposure = is_exr ? 1.0 : choose_exposure(stack);
  const fs::path folder = is_exr ? arguments.exr : arguments.png;
  require_absent(folder, common.force);
  fs::create_directories(folder);
  const std::vector<session::SessionLight> seen = relight::lights_in_picture(session);
  std::vector<std::string> names;
  for_each_light_image(stack, common.memory_bytes / 2, [&](int k, const Image<float>& picture) {
    const fs::path file = folder / fmt::format("light_{:04}.{}", k, is_exr ? "exr" : "png");
    PictureNotes notes = relight::notes_of(session.info());
    relight::add_light(session.info(), k, notes);
    relight::add_seen_light(session.info(), seen, k, notes);
    write_image(file, picture.view(), exposure, notes);
    names.push_back(fs::absolute(file)
                        .lexically_normal()
                        .lexically_relative(fs::absolute(arguments.out).parent_path())
                        .generic_string());
  });
  if (is_exr) {
    fmt::print("{}: {}\n", folder.string(), counted(names.size(), "linear picture"));
  } else {
    fmt::print("{}: {}, exposure {:.6g}\n", folder.string(), counted(names.size(), "picture"),
               exposure);
  }
  return names;
}

ExitCode run_export(const ExportArguments& arguments, const CommonOptions& common,
                    Report& report) {
  report.add_input(arguments.session);
  if (int{arguments.lp} + int{arguments.dome} + int{arguments.transforms} != 1) {
    throw Error("give one of --lp, --dome and --transforms", "",
                "for example: --lp -o lights.lp", ExitCode::usage);
  }
  if (arguments.transforms && !arguments.is_developed()) {
    throw Error("--transforms names developed pictures", "", "add --exr DIR or --png DIR",
                ExitCode::usage);
  }
  require_absent(arguments.out, common.force);
  const session::Session session = session::Session::open(arguments.session);
  std::string text;
  if (arguments.transforms) {  // what it lacks is told before pictures are written
    (void)session::export_transforms(session,
                                     std::vector<std::string>(session.info().lights.size()));
  }
  std::vector<std::string> pictures;
  if (!arguments.is_developed() && !session.info().form.gains.empty()) {
    log_warning(
        "the frames are as imported: the gains of their white reference are not in them, but "
        "are in developed pictures (--exr DIR or --png DIR)");
  }
  if (arguments.is_developed()) {
    pictures = write_pictures(session, arguments, common);
  }
  if (arguments.lp) {
    if (pictures.empty()) {
      pictures = session::picture_of_each_light(session, fs::path(arguments.out).parent_path());
    }
    text = session::export_lp(session, pictures);
    if (const std::string problem = session::find_lp_problem(pictures); !problem.empty()) {
      log_warning(problem);
    }
  } else if (arguments.transforms) {
    text = session::export_transforms(session, pictures);
  } else {
    text = session::export_dome(session, arguments.is_developed()
                                             ? session::ExportedPictures::developed
                                             : session::ExportedPictures::raw);
  }
  write_file_atomically(arguments.out, text);
  report.set_bytes(text.size());
  report.add_achieved("lights", static_cast<std::int64_t>(session.info().lights.size()));
  fmt::print("{}: {}\n", arguments.out, counted(session.info().lights.size(), "light"));
  return ExitCode::done;
}

}  // namespace

void add_export(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ExportArguments>();
  Command verb = root.add_verb("export", "Write a session's lights for other programs");
  verb.option("SESSION", &arguments->session, "Session folder", {.is_required = true});
  verb.flag("--lp", &arguments->lp,
            "RTI's list: one line per picture, with its unit direction");
  verb.flag("--dome", &arguments->dome, "Relight's .dome: positions and LED factors");
  verb.flag(
      "--transforms", &arguments->transforms,
      "transforms.json of NeRF and relighting: camera, and each picture's light (pl_pos)");
  verb.option("-o,--output", &arguments->out, "File to write",
              {.type = "FILE", .is_required = true});
  verb.option("--png", &arguments->png,
              "Also develop one sRGB PNG per light here, and name these in the list",
              {.type = "DIR"});
  verb.option(
      "--exr", &arguments->exr,
      "Also develop one linear EXR per light here (all exposures merged), and name these "
      "in the list",
      {.type = "DIR", .excludes = "--png"});
  verb.footer(
      "Directions are seen from the rig's object_centre.\n"
      "Examples:\n"
      "  haarlight export cube.session --lp -o cube.lp --png cube.png/\n"
      "  haarlight export cube.session --dome -o cube.dome --exr cube.exr/\n"
      "  haarlight export cube.session --transforms -o transforms.json --exr olat/");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_export(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
