// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight rig VERB RIG.toml`: the options of calibrate and predict, and the table of its
/// verbs.

#include <utility>

#include "apps/haarlight/rig/rig.h"
#include "apps/haarlight/rig/rig_calibrate.h"
#include "apps/haarlight/rig/rig_predict.h"
#include "apps/haarlight/verb.h"

namespace haarlight::apps {

namespace {

void add_rig_file(Command verb, std::string& rig) {
  verb.option("RIG", &rig, "Rig file", {.type = "RIG.toml", .is_required = true});
}

void add_page(Command verb, std::string& page, const char* ending) {
  verb.option("--page", &page,
              std::string("The page with figures (default: NAME") + ending + ")",
              {.type = "FILE"});
}

/// Of a chessboard.
void add_board_options(Command verb, CalibrateArguments& arguments) {
  add_rig_file(verb, arguments.rig);
  verb.option("--picture", &arguments.pictures, "A picture of the chessboard; may be repeated",
              {.type = "PICTURE"});
  verb.option("--board", &arguments.board, "The board's inner corners (default 9,6)",
              {.type = "COLUMNS,ROWS", .delimiter = ',', .count = 2});
  verb.option("--square", &arguments.square_mm, "A square's side, mm", {.shows_default = true});
  verb.option("--camera", &arguments.camera, "The camera that looks (default: the first)",
              {.type = "ID"});
}

/// Of a sheet.
void add_sheet_options(Command verb, CalibrateArguments& arguments) {
  add_rig_file(verb, arguments.rig);
  verb.option("--session", &arguments.session,
              "The capture of the sheet, one light per picture", {.type = "SESSION"});
  verb.option("--region", &arguments.region,
              "The sheet on the plane, mm along its u and v (default: the middle four fifths)",
              {.type = "U0,U1,V0,V1", .delimiter = ',', .count = 4});
  verb.option("--sheet", &arguments.sheet_mm, "The sheet's thickness over the plane, mm",
              {.shows_default = true});
  verb.option("--bow", &arguments.bow_mm,
              "How far the sheet may be bowed, mm (a standard deviation); 0: it is flat for "
              "certain",
              {.bounds = Bounds{0, 20}, .shows_default = true});
  verb.option("--lobe", &arguments.lobe,
              "free finds one exponent for each face; given takes the rig file's",
              {.choices = choices_of({relight::Lobe::free, relight::Lobe::given}),
               .shows_default = true});
}

using RunCalibrate = ExitCode (*)(const CalibrateArguments& arguments,
                                  const CommonOptions& common, Report& report);

void finish_calibrate(Command verb, std::shared_ptr<CalibrateArguments> arguments,
                      RunCalibrate run, Invocation& invocation) {
  finish_verb(verb, invocation,
              [arguments = std::move(arguments), run, action = verb.name().substr(4)](
                  const CommonOptions& common, Report& report) {
                report.add_input(arguments->rig);
                report.add_requested("action", action);
                return run(*arguments, common, report);
              });
}

void add_calibrate_camera(Command calibrate, Invocation& invocation) {
  auto arguments = std::make_shared<CalibrateArguments>();
  Command verb =
      calibrate.add_verb("camera", "Find the lens from pictures of a printed chessboard");
  add_board_options(verb, *arguments);
  add_page(verb, arguments->page, ".camera.html");
  verb.footer(
      "Example:\n"
      "  haarlight rig calibrate camera lab.toml --picture a.png --picture b.png \\\n"
      "    --picture c.png --board 9,6 --square 40");
  finish_calibrate(verb, std::move(arguments), run_calibrate_camera, invocation);
}

void add_calibrate_plane(Command calibrate, Invocation& invocation) {
  auto arguments = std::make_shared<CalibrateArguments>();
  Command verb = calibrate.add_verb(
      "plane", "Find the first plane from pictures of a chessboard that lies on it");
  add_board_options(verb, *arguments);
  add_page(verb, arguments->page, ".plane.html");
  verb.footer(
      "Example:\n"
      "  haarlight rig calibrate plane lab.toml --picture flat.png --board 9,6 --square 40");
  finish_calibrate(verb, std::move(arguments), run_calibrate_plane, invocation);
}

void add_calibrate_lights(Command calibrate, Invocation& invocation) {
  auto arguments = std::make_shared<CalibrateArguments>();
  Command verb = calibrate.add_verb(
      "lights", "Find where the lights are, from a capture of a flat matte sheet");
  add_sheet_options(verb, *arguments);
  add_page(verb, arguments->page, ".lights.html");
  verb.footer(
      "Exit code 1: the pictures contradict the model; then nothing is stored.\n"
      "Example:\n"
      "  haarlight rig calibrate lights configs/rigs/small8.toml --session sheet.session");
  finish_calibrate(verb, std::move(arguments), run_calibrate_lights, invocation);
}

void add_rig_calibrate(Command rig, Invocation& invocation) {
  Command verb = rig.add_verb("calibrate",
                              "Find lens and plane from a chessboard, the lights from a sheet");
  verb.require_verb();
  add_calibrate_camera(verb, invocation);
  add_calibrate_plane(verb, invocation);
  add_calibrate_lights(verb, invocation);
  verb.footer(
      "Each puts what it found into NAME.measured.toml beside the rig file; every program "
      "then\n"
      "puts these values over the written ones. How to take the pictures:\n"
      "docs/reference/calibration.md.");
}

void add_rig_predict(Command rig, Invocation& invocation) {
  struct Arguments {
    std::string rig;
    PredictArguments predict;
    bool is_json = false;
  };
  auto arguments = std::make_shared<Arguments>();
  Command verb =
      rig.add_verb("predict", "Tell how finely shadows will be sampled, from the file alone");
  add_rig_file(verb, arguments->rig);
  verb.option("--object-height", &arguments->predict.object_height,
              "Lowest and highest point of the object over the plane, mm",
              {.type = "LOW,HIGH", .delimiter = ',', .count = 2});
  verb.option("--strip", &arguments->predict.strip_mm,
              "Width of the strip whose ripple is told, mm", {.shows_default = true});
  verb.option("--sun", &arguments->predict.sun_deg, "Angular diameter of a hard sun, degrees",
              {.shows_default = true});
  verb.option("--receiver", &arguments->predict.receivers,
              "Heights over the plane of surfaces to draw on, mm",
              {.type = "MM,...", .delimiter = ','});
  verb.flag("--json", &arguments->is_json, "The table as JSON");
  verb.footer(
      "Example:\n"
      "  haarlight rig predict configs/rigs/cube32.toml --object-height 76,128 "
      "--receiver=-100,50");
  finish_verb(verb, invocation, [arguments](const CommonOptions&, Report& report) {
    report.add_input(arguments->rig);
    report.add_requested("action", std::string("predict"));
    run_predict(arguments->rig, arguments->predict, arguments->is_json, report);
    return ExitCode::done;
  });
}

}  // namespace

void add_rig(Command root, Invocation& invocation) {
  Command verb =
      root.add_verb("rig", "Examine a rig, measure what it really does, or predict it");
  verb.require_verb();
  add_rig_doctor(verb, invocation);
  add_rig_commission(verb, invocation);
  add_rig_calibrate(verb, invocation);
  add_rig_predict(verb, invocation);
  verb.footer("haarlight rig VERB --help tells the options of each.");
}

}  // namespace haarlight::apps
