// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight plan RIG PLAN`: expands a plan for a rig and says what it will cost.

#include "haarlight/capture/plan/plan.h"

#include <fmt/format.h>

#include "apps/haarlight/options/lighting_reader.h"
#include "apps/haarlight/verb.h"
#include "core/counted.h"
#include "haarlight/core/files.h"
#include "haarlight/core/rig/rig.h"

namespace haarlight::apps {

namespace {

struct PlanArguments {
  std::string rig;
  std::string plan;
  std::string output;
  bool is_dry_run = false;
};

void print_cost(const capture::Plan& plan, const capture::DryRun& run, const Rig& rig) {
  fmt::print("plan \"{}\" for rig \"{}\": {}, {} of them light, hash {}\n", plan.name, rig.name,
             counted(run.n_shots, "shot"), run.n_light_shots, plan.hash);
  fmt::print("time   {:.1f} s ({:.1f} frame times per shot, {} at {} fps)\n", run.seconds,
             run.frames_a_shot, to_string(rig.sync), rig.cameras.front().fps);
  fmt::print("disk   {:.1f} MB, {:.1f} MB/s\n", static_cast<double>(run.bytes) * 1e-6,
             run.bytes_a_second * 1e-6);
  fmt::print("power  {:.1f} W at most, {:.1f} W on average; within every face's limit\n",
             run.peak_watts, run.mean_watts);
  fmt::print("duty   {:.2f} % for light {}, the busiest\n", 100.0 * run.highest_duty,
             run.busiest_light);
}

ExitCode run_plan(const PlanArguments& arguments, bool is_forced, Report& report) {
  report.add_input(arguments.rig);
  report.add_input(arguments.plan);
  if (!arguments.output.empty() && !arguments.is_dry_run) {
    require_absent(arguments.output, is_forced);
  }
  const Rig rig = read_rig(arguments.rig);
  const capture::Plan plan = capture::load_plan(arguments.plan, rig, read_lighting);
  const capture::DryRun run = capture::dry_run(plan, rig);
  print_cost(plan, run, rig);
  report.add_achieved("shots", std::int64_t{run.n_shots});
  report.add_achieved("seconds", run.seconds);
  report.add_achieved("frame_bytes", static_cast<double>(run.bytes));
  report.add_achieved("peak_watts", run.peak_watts);
  report.add_achieved("mean_watts", run.mean_watts);
  report.add_achieved("highest_duty", run.highest_duty);
  report.add_detail("plan_hash", plan.hash);
  if (!arguments.output.empty() && !arguments.is_dry_run) {
    const std::string json = capture::plan_to_json(plan);
    write_file_atomically(arguments.output, json);
    report.set_bytes(json.size());
  }
  return ExitCode::done;
}

}  // namespace

void add_plan(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<PlanArguments>();
  Command verb = root.add_verb("plan", "Expand a plan for a rig; say its time, disk and power");
  verb.option("RIG", &arguments->rig, "Rig file", {.type = "RIG.toml", .is_required = true});
  verb.option("PLAN", &arguments->plan, "Plan file, or a plan.json",
              {.type = "PLAN.toml", .is_required = true});
  verb.option("-o", &arguments->output, "Write the shot list", {.type = "plan.json"});
  verb.flag("--dry-run", &arguments->is_dry_run, "Only say what it would cost");
  verb.footer(
      "A plan that exceeds a face's max_watts is refused here, before a light is lit.\n"
      "Example:\n"
      "  haarlight plan configs/rigs/cube32.toml configs/plans/one_at_a_time.toml --dry-run");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_plan(*arguments, common.force, report);
  });
}

}  // namespace haarlight::apps
