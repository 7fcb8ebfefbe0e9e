// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight correct SESSION -o FOLDER`: each light's fall-off, and the pictures without
/// it.

#include <memory>
#include <string>

#include <fmt/format.h>

#include "apps/haarlight/options/develop_options.h"
#include "apps/haarlight/options/pipeline_words.h"
#include "core/counted.h"
#include "relight/pipeline/correct_pipeline.h"

namespace haarlight::apps {

namespace {

struct CorrectArguments {
  std::string session;
  std::string out;
  relight::FallOff fall_off = relight::FallOff::plane;
  std::optional<Transfer> transfer;
  PlaneArguments plane;
};

ExitCode run_correct(const CorrectArguments& arguments, const CommonOptions& common,
                     Report& report) {
  relight::CorrectOptions options;
  options.session = arguments.session;
  options.out = arguments.out;
  options.fall_off = arguments.fall_off;
  options.transfer = arguments.transfer;
  options.width_mm = arguments.plane.width_mm;
  options.height_mm = arguments.plane.height_mm;
  options.settings = pipeline_settings(common);
  const relight::CorrectSummary summary = relight::correct_fall_off(options);
  report.add_input(arguments.session);
  report.add_requested("fall_off", std::string(to_string(arguments.fall_off)));
  report.add_achieved("lights", std::int64_t{summary.n_lights});
  report.add_achieved("least_fall_off", summary.least_fall_off);
  report.set_bytes(summary.bytes);
  fmt::print("{}: {}; the weakest corner had {:.3g} of its light's middle\n", arguments.out,
             counted(summary.n_lights, "picture"), summary.least_fall_off);
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
              {.choices = choices_of({relight::FallOff::plane, relight::FallOff::distance}),
               .shows_default = true});
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

}  // namespace haarlight::apps
