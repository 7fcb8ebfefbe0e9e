// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight import DIR --lights FILE -o SESSION`: others' pictures become a session.

#include "haarlight/session/import/import.h"

#include <array>
#include <cstdio>

#include <fmt/format.h>

#include "apps/haarlight/options/develop_options.h"
#include "apps/haarlight/options/picture_options.h"
#include "core/counted.h"
#include "haarlight/core/error.h"

namespace haarlight::apps {

namespace {

struct ImportArguments {
  std::string folder;
  std::string lights;
  std::string target;
  PictureListArguments list;
  std::optional<Transfer> transfer;  ///< nothing: as the file says
  std::vector<std::string> dark;
  std::string grid;
  std::string white;
};

/// "32x32"
std::array<int, 2> parse_grid(const std::string& text) {
  std::array<int, 2> grid{};
  char rest = '\0';
  if (std::sscanf(text.c_str(), "%dx%d%c", &grid[0], &grid[1], &rest) != 2 || grid[0] < 1 ||
      grid[1] < 1 || grid[0] > 4096 || grid[1] > 4096) {
    throw Error("not ROWSxCOLUMNS", "--grid " + text, "for example: --grid 32x32",
                ExitCode::usage);
  }
  return grid;
}

/// "40,30,12,10" or "40,30,12,10=0.9"
session::WhitePatch parse_white(const std::string& text) {
  const std::size_t equals = text.find('=');
  session::WhitePatch white{parse_rectangle(text.substr(0, equals), "--white"), {}};
  if (equals != std::string::npos) {
    double reflectance = 0.0;
    char rest = '\0';
    if (std::sscanf(text.c_str() + equals + 1, "%lf%c", &reflectance, &rest) != 1 ||
        !(reflectance > 0.0 && reflectance <= 1.0)) {
      throw Error("not a reflectance above 0 and up to 1", "--white " + text,
                  "for example: --white 40,30,12,10=0.18 for a grey card", ExitCode::usage);
    }
    white.reflectance = reflectance;
  }
  return white;
}

void report_white(const session::WhiteReference& white, Report& report) {
  report.add_achieved("white lights used", std::int64_t{white.n_used});
  report.add_achieved("white lights clipped", std::int64_t{white.n_clipped});
  report.add_achieved("white lights dark", std::int64_t{white.n_dark});
  report.add_detail("white gains", white.gains);
  report.add_detail("white scatter", white.scatter);
}

ExitCode run_import(const ImportArguments& arguments, const CommonOptions& common,
                    Report& report) {
  report.add_input(arguments.folder);
  if (!arguments.lights.empty()) {
    report.add_input(arguments.lights);
  } else if (arguments.list.coordinates != session::LightCoordinates::automatic) {
    throw Error("pictures that say where their lights are say in what, too", "--places",
                "leave it out, or name the list of lights: --lights FILE", ExitCode::usage);
  }
  report.add_requested("places", std::string(to_string(arguments.list.coordinates)));
  report.add_requested(
      "transfer", arguments.transfer ? std::string(to_string(*arguments.transfer)) : kAsFile);
  session::ImportOptions options;
  options.coordinates = arguments.list.coordinates;
  options.transfer = arguments.transfer;
  options.match = match_options(arguments.list);
  options.match.dark.assign(arguments.dark.begin(), arguments.dark.end());
  if (!arguments.grid.empty()) {
    options.grid = parse_grid(arguments.grid);
  }
  options.crop = crop_requested(arguments.list);
  if (!arguments.white.empty()) {
    options.white = parse_white(arguments.white);
  }
  options.force = common.force;
  options.progress = common.progress();
  const session::ImportResult result =
      session::import_pictures(arguments.folder, arguments.lights, arguments.target, options);
  const session::FrameForm& form = result.info.form;
  std::uint64_t bytes = 0;
  for (const session::FrameRecord& frame : result.info.frames) {
    bytes += std::filesystem::file_size(std::filesystem::path(arguments.target) / frame.file);
  }
  report.set_bytes(bytes);
  report.add_achieved("lights", static_cast<std::int64_t>(result.info.lights.size()));
  report.add_achieved("frames", static_cast<std::int64_t>(result.info.frames.size()));
  if (result.white) {
    report_white(*result.white, report);
  }
  tell_match(result.notes, result.disagreements, common);
  fmt::print("{}: {}, {} x {} x {}, {} MiB\n", arguments.target,
             counted(result.info.lights.size(), "light"), form.width, form.height,
             form.channels, bytes >> 20U);
  tell_next(common, {"fit", arguments.target, "-o", "NAME"});
  return ExitCode::done;
}

}  // namespace

void add_import(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ImportArguments>();
  Command verb = root.add_verb("import", "Make a session of other programs' pictures");
  verb.option("DIR", &arguments->folder, "Folder with one picture per light",
              {.is_required = true});
  verb.option("--lights", &arguments->lights,
              "List of lights: .lp, .dome, .json or transforms.json (default: each picture "
              "says where its light is, as EXRs of export do)",
              {.type = "FILE"});
  verb.option("-o,--output", &arguments->target, "Session folder to make",
              {.type = "SESSION", .is_required = true});
  add_picture_list_options(verb, arguments->list);
  verb.option("--transfer", &arguments->transfer,
              "What integer pictures hold; file: as the file says (display pictures: srgb)",
              {.choices = known_transfers(), .none = kAsFile, .shows_default = true});
  verb.option("--dark", &arguments->dark, "A picture with all lights off; may be repeated",
              {.type = "PICTURE"});
  verb.option("--grid", &arguments->grid,
              "The lights are grids, row by row, face after face (default: looked for in their "
              "positions)",
              {.type = "ROWSxCOLUMNS"});
  verb.option(
      "--white", &arguments->white,
      "A neutral patch in every picture: all are scaled by the gains that make it "
      "grey. R: its reflectance, 0..1; a white that faces the light is then 1 (default: "
      "the patch keeps its brightest channel)",
      {.type = "X,Y,W,H[=R]"});
  verb.footer(
      "Examples:\n"
      "  haarlight import door/ --lights door/dirs.lp -o door.session\n"
      "  haarlight import rig/ --lights rig.lp --places positions --grid 8x8 -o rig.session\n"
      "  haarlight import card/ --lights card/relief.lp --white 75,51,14,14 \\\n"
      "    --crop 0,0,72,72 -o card.session\n"
      "  haarlight import lit/ -o lit.session\n"
      "  haarlight import ball/ --lights lights.txt --exclude mask -o ball.session");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_import(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
