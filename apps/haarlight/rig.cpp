// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight rig doctor|commission|calibrate|predict RIG.toml`: is everything there, what does
/// it really do, and what will it capture?

#include <fmt/format.h>

#include "apps/haarlight/rig_calibrate.h"
#include "apps/haarlight/rig_commission.h"
#include "apps/haarlight/rig_predict.h"
#include "apps/haarlight/verb.h"
#include "capture/daemon/daemon_client.h"
#include "capture/doctor/doctor_words.h"

namespace haarlight {

namespace {

struct RigArguments {
  std::string action;
  std::string rig;
  std::string camera;
  std::string page;
  bool json = false;
  PredictArguments predict;
  std::string file;  ///< calibrate: the rig file, RIG being what to calibrate
  CalibrateArguments calibrate;
  CommissionArguments commission;
};

ExitCode run_doctor(const RigArguments& arguments, Report& report) {
  DoctorOptions options;
  options.fetch = fetch_local;
  const std::vector<DoctorLine> lines = examine_rig(arguments.rig, options);
  add_to_report(lines, report);
  fmt::print("{}", arguments.json ? doctor_json(lines) + "\n" : doctor_text(lines));
  return is_healthy(lines) ? ExitCode::done : ExitCode::target_missed;
}

ExitCode run_calibrate(const RigArguments& arguments, const CommonOptions& common,
                       Report& report) {
  CalibrateArguments calibrate = arguments.calibrate;
  calibrate.rig = arguments.file;
  calibrate.page = arguments.page;
  calibrate.camera = arguments.camera;
  const std::string& what = arguments.rig;
  if (arguments.file.empty() || (what != "camera" && what != "plane" && what != "lights")) {
    throw Error("calibrate what, of which rig?", what,
                "haarlight rig calibrate camera|plane|lights RIG.toml", ExitCode::usage);
  }
  return what == "camera"  ? run_calibrate_camera(calibrate, common, report)
         : what == "plane" ? run_calibrate_plane(calibrate, common, report)
                           : run_calibrate_lights(calibrate, common, report);
}

ExitCode run_rig(const RigArguments& arguments, const CommonOptions& common, Report& report) {
  report.add_input(arguments.rig);
  report.add_asked("action", arguments.action);
  if (arguments.action == "calibrate") {
    return run_calibrate(arguments, common, report);
  }
  if (arguments.action == "predict") {
    run_predict(arguments.rig, arguments.predict, arguments.json, report);
    return ExitCode::done;
  }
  if (arguments.action == "doctor") {
    return run_doctor(arguments, report);
  }
  CommissionArguments commission = arguments.commission;
  commission.options.rig = arguments.rig;
  commission.options.camera = arguments.camera;
  commission.options.page = arguments.page;
  return run_commission(commission, common, report);
}

}  // namespace

void add_rig(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<RigArguments>();
  Command verb =
      root.add_verb("rig", "Examine a rig, measure what it really does, or predict it");
  verb.option(
      "ACTION", &arguments->action,
      "doctor: what is there, what was expected, and the cure; lights nothing\n"
      "commission: measure delays, time stamps, noise and lights by flashing them\n"
      "calibrate camera|plane|lights: the lens and the plane from pictures of a printed "
      "chessboard,\nwhere the lights are from a capture of a flat matte sheet\n"
      "predict: how finely shadows will be sampled, from the file alone",
      {.type = "doctor|commission|calibrate|predict",
       .choices = {"doctor", "commission", "calibrate", "predict"},
       .is_required = true});
  verb.option("RIG", &arguments->rig, "Rig file; after calibrate: camera, plane or lights",
              {.type = "RIG.toml", .is_required = true});
  verb.option("FILE", &arguments->file, "calibrate: the rig file", {.type = "RIG.toml"});
  add_calibrate_options(verb, arguments->calibrate);
  verb.flag("--json", &arguments->json, "doctor, predict: the table as JSON");
  add_predict_options(verb, arguments->predict);
  verb.option("--camera", &arguments->camera,
              "commission, calibrate: the camera that looks (default: the first)",
              {.type = "ID"});
  add_commission_options(verb, arguments->commission);
  verb.option("--page", &arguments->page,
              "commission, calibrate: the page with figures (default: NAME.commission.html, "
              "NAME.lights.html, ...)",
              {.type = "FILE"});
  verb.footer(
      "commission writes NAME.measured.toml beside the rig file; every program then puts these "
      "values\nover the written ones. The daemon must not be running. "
      "docs/reference/commissioning.md "
      "tells how to set up.\nExit codes: 1 when the doctor finds something wrong, or the rig "
      "file\ncontradicts what was measured, or lights are dead, dim or swapped.\n"
      "Examples:\n"
      "  haarlight rig doctor configs/rigs/small8.toml\n"
      "  haarlight rig commission configs/rigs/small8.toml --flash-ok\n"
      "  haarlight rig calibrate lights configs/rigs/small8.toml --session sheet.session\n"
      "  haarlight rig predict configs/rigs/cube32.toml --object-height 76,128 "
      "--receiver=-100,50");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_rig(*arguments, common, report);
  });
}

}  // namespace haarlight
