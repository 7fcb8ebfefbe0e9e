// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight shape INPUT -o FOLDER`: normals, albedo, heights and a mesh of a capture.

#include <memory>

#include <fmt/format.h>

#include "apps/haarlight/options/shape_options.h"
#include "core/log.h"
#include "relight/pipeline/shape/shape_report.h"

namespace haarlight::apps {

namespace {

ExitCode run_shape(const ShapeArguments& arguments, const CommonOptions& common,
                   Report& report) {
  const relight::ShapePipelineOptions options = shape_options(arguments, common);
  const relight::ShapeSummary summary = relight::recover_capture_shape(options);
  report.add_input(arguments.input);
  report.add_requested("integrate", std::string(to_string(arguments.integrate)));
  report.add_requested("mask", arguments.mask);
  report.add_requested("method", summary.method);
  relight::report_shape(summary, report);
  fmt::print("{}", relight::shape_text(options, summary));
  for (const std::string& warning : relight::shape_warnings(summary)) {
    log_warning(warning);
  }
  for (const std::string& failure : relight::shape_failures(summary)) {
    log_error(failure);
  }
  return summary.is_usable() ? ExitCode::done : ExitCode::target_missed;
}

}  // namespace

void add_shape(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<ShapeArguments>();
  Command verb =
      root.add_verb("shape", "Recover normals, albedo, heights and a mesh of a capture");
  add_shape_options(verb, *arguments);
  verb.footer(
      "Writes normals (.png, .exr), their standard errors in degrees (sigma.exr; sigma.png, "
      "white: 20\nor more), albedo (.png, .exr), error (.png, .exr), height (.tif, .exr), "
      "mask.png, mesh.ply,\nmesh.obj and preview.png. Of a rig's capture each part's height "
      "above the plane is found from\nthe lights' fall-off unless --height-mm gives it; else "
      "each part's mean height is 0. Normals of\nptm and hsh are not measured: instead of "
      "albedo, errors and mask there is front.png, the\npicture lit from the camera.\n\n"
      "Examples:\n"
      "  haarlight shape sessions/airplane -o airplane.shape\n"
      "  haarlight shape sessions/airplane -o airplane.parts --hull airplane.hlb.hull\n"
      "  haarlight shape sessions/coin -o coin.shape --light far --integrate robust\n"
      "  haarlight shape sessions/coin -o coin.hsh --method hsh\n"
      "  haarlight shape coin.ptm -o coin.peaks");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_shape(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
