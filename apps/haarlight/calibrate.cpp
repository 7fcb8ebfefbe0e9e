// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight calibrate INPUT -o OUT`: where the lights are, from pictures of mirror balls or
/// of a sheet.

#include <memory>

#include <fmt/format.h>

#include "apps/haarlight/options/calibrate_options.h"
#include "apps/haarlight/options/pipeline_words.h"
#include "relight/pipeline/calibrate/calibrate_pipeline.h"

namespace haarlight::apps {

namespace {

relight::SheetTargetOptions sheet_options(const FindLightsArguments& arguments) {
  relight::SheetTargetOptions sheet;
  if (!arguments.region.empty()) {
    sheet.region = relight::SheetRegion{arguments.region[0], arguments.region[1],
                                        arguments.region[2], arguments.region[3]};
  }
  sheet.aim = arguments.aim;
  sheet.aim_deg = arguments.aim_deg;
  sheet.tilt_deg = arguments.tilt_deg;
  sheet.led_mm = arguments.led_mm;
  sheet.lobe = arguments.lobe;
  sheet.mu = arguments.mu;
  sheet.bow_mm = arguments.bow_mm;
  sheet.samples = arguments.samples;
  sheet.is_bent = arguments.is_bent;
  if (!arguments.grid.empty()) {
    sheet.grid = relight::LightGrid{arguments.grid[0], arguments.grid[1], arguments.pitch_mm};
  }
  sheet.thickness_mm = arguments.sheet_mm;
  sheet.page = arguments.page;
  return sheet;
}

relight::CalibratePipelineOptions calibrate_options(const FindLightsArguments& arguments,
                                                    const CommonOptions& common) {
  relight::CalibratePipelineOptions options;
  options.input = arguments.input;
  options.out = arguments.out;
  options.target = arguments.target;
  options.exclude = arguments.exclude;
  options.transfer = arguments.transfer;
  options.width_mm = arguments.width_mm;
  options.camera_mm = arguments.camera_mm;
  options.focal_px = arguments.focal_px;
  options.rig = arguments.rig;
  options.ball.masks.assign(arguments.masks.begin(), arguments.masks.end());
  options.ball.n_balls = arguments.n_balls;
  options.ball.radius_mm = arguments.radius_mm;
  options.ball.edge_px = arguments.edge_px;
  options.sheet = sheet_options(arguments);
  options.settings = pipeline_settings(common);
  return options;
}

ExitCode run_calibrate(const FindLightsArguments& arguments, const CommonOptions& common,
                       Report& report) {
  const relight::CalibrateSummary summary =
      relight::calibrate_capture_lights(calibrate_options(arguments, common));
  report.add_input(arguments.input);
  relight::report_calibration(summary, report);
  fmt::print("{}{}", common.quiet ? std::string() : relight::found_table(summary.found),
             relight::found_line(summary.found));
  if (!summary.are_all_seen) {
    fmt::print(stderr,
               "lights that were not seen are left out of the lists\n  hint: look at their "
               "pictures, or leave these out: --exclude\n");
  }
  fmt::print("{}\n", arguments.out);
  return summary.is_usable() ? ExitCode::done : ExitCode::target_missed;
}

}  // namespace

void add_calibrate(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<FindLightsArguments>();
  Command verb = root.add_verb(
      "calibrate", "Find where a dome's or free lights are, from a sheet or mirror balls");
  add_calibrate_options(verb, *arguments);
  verb.footer(
      "Writes lights.json (positions or directions, powers, standard errors; import reads "
      "it),\n"
      "lights.lp, lights.csv, and balls.png or sheet.png. Which way to take, and how exact it "
      "is:\n"
      "docs/reference/calibration.md. Exit code 1: a light was not seen, or the pictures "
      "contradict the\n"
      "model; then no standard error is given.\n"
      "Examples:\n"
      "  haarlight calibrate chrome/ --target ball -o chrome.lights\n"
      "  haarlight calibrate balls/ --target ball --balls 4 --radius-mm 12 --focal-px 1600 \\\n"
      "    --transfer linear -o balls.lights\n"
      "  haarlight calibrate paper/ --target sheet --width-mm 250 --camera-mm 740 \\\n"
      "    --transfer linear -o dome.lights\n"
      "  haarlight calibrate sheet.session -o rig.lights");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_calibrate(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
