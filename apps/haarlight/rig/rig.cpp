// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight rig doctor|commission RIG.toml`: is everything there, and what does it really do?

#include "apps/haarlight/rig/rig.h"

#include <fmt/format.h>

#include "apps/haarlight/rig/rig_commission.h"
#include "apps/haarlight/verb.h"
#include "capture/doctor/doctor_words.h"
#include "haarlight/capture/daemon/daemon_client.h"

namespace haarlight::apps {

namespace {

struct DoctorArguments {
  std::string rig;
  bool json = false;
};

ExitCode run_doctor(const DoctorArguments& arguments, Report& report) {
  capture::DoctorOptions options;
  options.fetch = capture::fetch_local;
  const std::vector<capture::DoctorLine> lines = capture::examine_rig(arguments.rig, options);
  capture::add_to_report(lines, report);
  fmt::print("{}",
             arguments.json ? capture::doctor_json(lines) + "\n" : capture::doctor_text(lines));
  return capture::is_healthy(lines) ? ExitCode::done : ExitCode::target_missed;
}

}  // namespace

void add_rig_doctor(Command rig, Invocation& invocation) {
  auto arguments = std::make_shared<DoctorArguments>();
  Command verb = rig.add_verb(
      "doctor", "Tell what is there, what was expected, and a hint; lights nothing");
  verb.option("RIG", &arguments->rig, "Rig file", {.type = "RIG.toml", .is_required = true});
  verb.flag("--json", &arguments->json, "The table as JSON");
  verb.footer(
      "Exit code 1: something is wrong.\n"
      "Example:\n"
      "  haarlight rig doctor configs/rigs/small8.toml");
  finish_verb(verb, invocation, [arguments](const CommonOptions&, Report& report) {
    report.add_input(arguments->rig);
    report.add_requested("action", std::string("doctor"));
    return run_doctor(*arguments, report);
  });
}

void add_rig_commission(Command rig, Invocation& invocation) {
  auto arguments = std::make_shared<CommissionArguments>();
  capture::CommissionRigOptions& options = arguments->options;
  Command verb = rig.add_verb("commission",
                              "Measure delays, timestamps, noise and lights by flashing them");
  verb.option("RIG", &options.rig, "Rig file", {.type = "RIG.toml", .is_required = true});
  verb.option("--camera", &options.camera, "The camera that looks (default: the first)",
              {.type = "ID"});
  add_commission_options(verb, *arguments);
  verb.option("--page", &options.page, "The page with figures (default: NAME.commission.html)",
              {.type = "FILE"});
  verb.footer(
      "Writes NAME.measured.toml beside the rig file; every program then puts these values "
      "over\nthe written ones. The daemon must not be running. "
      "docs/reference/commissioning.md tells how to set up.\n"
      "Exit code 1: the rig file contradicts what was measured, or lights are dead, dim or "
      "swapped.\n"
      "Example:\n"
      "  haarlight rig commission configs/rigs/small8.toml --flash-ok");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    report.add_input(arguments->options.rig);
    report.add_requested("action", std::string("commission"));
    return run_commission(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
