/// @file
/// `haarlight import DIR --lights FILE -o SESSION`: others' pictures become a session.

#include "session/import.h"

#include <fmt/format.h>

#include "apps/haarlight/verb.h"

namespace haarlight {

namespace {

struct ImportArguments {
  std::string folder;
  std::string lights;
  std::string target;
  std::string places = "automatic";
  std::string transfer = "file";
  std::vector<std::string> dark;
  std::vector<std::string> exclude;
};

ExitCode run_import(const ImportArguments& arguments, const CommonOptions& common,
                    Report& report) {
  report.add_input(arguments.folder);
  report.add_input(arguments.lights);
  report.add_asked("places", arguments.places);
  report.add_asked("transfer", arguments.transfer);
  ImportOptions options;
  if (arguments.places != "automatic") {
    options.places =
        arguments.places == "positions" ? LightPlaces::positions : LightPlaces::directions;
  }
  if (arguments.transfer != "file") {
    options.transfer = arguments.transfer == "srgb" ? Transfer::srgb : Transfer::linear;
  }
  options.dark.assign(arguments.dark.begin(), arguments.dark.end());
  options.exclude = arguments.exclude;
  options.force = common.force;
  options.progress = common.progress();
  const ImportResult result =
      import_pictures(arguments.folder, arguments.lights, arguments.target, options);
  const FrameForm& form = result.info.form;
  std::uint64_t bytes = 0;
  for (const FrameRecord& frame : result.info.frames) {
    bytes += std::filesystem::file_size(std::filesystem::path(arguments.target) / frame.file);
  }
  report.set_bytes(bytes);
  report.add_reached("lights", static_cast<std::int64_t>(result.info.lights.size()));
  report.add_reached("frames", static_cast<std::int64_t>(result.info.frames.size()));
  for (const std::string& note : result.notes) {
    if (!common.quiet) {
      fmt::print(stderr, "note: {}\n", note);
    }
  }
  fmt::print("{}: {} lights, {} x {} x {}, {} MiB\n", arguments.target,
             result.info.lights.size(), form.width, form.height, form.channels, bytes >> 20U);
  return ExitCode::done;
}

}  // namespace

void add_import(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ImportArguments>();
  Command verb = root.add_verb("import", "Make a session of other programs' pictures");
  verb.option("DIR", &arguments->folder, "Folder with one picture a light",
              {.is_required = true});
  verb.option("--lights", &arguments->lights, "List of lights: .lp, .dome or .json",
              {.type = "FILE", .is_required = true});
  verb.option("-o,--out", &arguments->target, "Session folder to make",
              {.type = "SESSION", .is_required = true});
  verb.option("--places", &arguments->places,
              "What the numbers of a .lp are: unit directions, or positions in mm",
              {.choices = {"automatic", "directions", "positions"}, .shows_default = true});
  verb.option("--transfer", &arguments->transfer,
              "What integer pictures hold; file: as the file says (display pictures: srgb)",
              {.choices = {"file", "srgb", "linear"}, .shows_default = true});
  verb.option("--dark", &arguments->dark, "A picture with all lights off; may be repeated",
              {.type = "PICTURE"});
  verb.option("--exclude", &arguments->exclude,
              "Leave out pictures whose names contain this; may be repeated", {.type = "TEXT"});
  verb.footer(
      "Examples:\n"
      "  haarlight import door/ --lights door/dirs.lp -o door.session\n"
      "  haarlight import rig/ --lights rig.lp --places positions -o rig.session\n"
      "  haarlight import ball/ --lights lights.txt --exclude mask -o ball.session");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_import(*arguments, common, report);
  });
}

}  // namespace haarlight
