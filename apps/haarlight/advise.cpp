// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight advise RIG`: which patterns pay, with the arithmetic.

#include <fmt/format.h>

#include "apps/haarlight/options/light_options.h"
#include "apps/haarlight/verb.h"
#include "capture/plan/advice_pilot.h"
#include "capture/plan/advice_words.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/basis/compress_session.h"
#include "haarlight/relight/light/light_weights.h"
#include "haarlight/session/develop/develop.h"
#include "relight/basis/plate/plate_sample.h"
#include "relight/basis/weight_list.h"

namespace haarlight::apps {

namespace {

struct AdviseArguments {
  std::string rig;
  std::optional<double> signal_e;
  std::string pilot;
  relight::LightChoice light;
  capture::AdviceOptions advice;
  int wavelets = 64;
  std::string output;
};

constexpr int kMaxPixels = 2048;  // the mean over them is within 3 % of all pixels' (1/sqrt)
constexpr int kSingleLights = 16;

/// The signal as --signal says it, or as a pilot has it.
capture::AdviceScene scene_of(const AdviseArguments& arguments, const Rig& rig,
                              const CommonOptions& common, Report& report) {
  if (arguments.pilot.empty()) {
    if (!arguments.signal_e) {
      throw Error("how bright is a light?", "haarlight advise",
                  "give --signal ELECTRONS of a lit pixel under one light, or --pilot SESSION",
                  ExitCode::usage);
    }
    report.add_requested("signal_e", *arguments.signal_e);
    return capture::plate_scene(relight::sample_plate(rig, kMaxPixels), rig.n_lights(),
                                *arguments.signal_e);
  }
  report.add_input(arguments.pilot);
  const session::Session session = session::Session::open(arguments.pilot);
  session::DevelopOptions options;
  options.memory_bytes = common.memory_bytes;
  options.progress = common.progress();
  options.keep_bayer = true;  // the noise of single pixels, not of their averages
  options.plate = relight::sharing_plate(session, {});
  const LightStack stack = session::develop(session, options);
  const StackDims shape = stack.dims();
  if (shape.n_lights != rig.n_lights()) {
    throw Error(
        fmt::format("the pilot has {} lights, the rig {}", shape.n_lights, rig.n_lights()),
        arguments.pilot, "use a session of this rig");
  }
  // The plate that develop will use, whether or not the pilot itself needed one.
  return capture::pilot_scene(session, stack, rig.cameras.front(),
                              relight::computed_pixels(rig, shape.width, shape.height),
                              kMaxPixels);
}

/// Single lights, and what the command line names; the first of those is the rig's own.
std::vector<capture::AdviceLighting> lightings_of(const AdviseArguments& arguments,
                                                  const Rig& rig, Report& report) {
  std::vector<capture::AdviceLighting> lightings{
      capture::single_lights(rig.n_lights(), kSingleLights)};
  if (!arguments.light.cubemap.empty()) {
    const render::Environment environment = relight::read_environment(arguments.light);
    report.add_input(arguments.light.cubemap);
    report.add_requested("rotate_deg", arguments.light.rotate_deg);
    report.add_detail("layout", std::string(to_string(environment.layout())));
    lightings.push_back({std::filesystem::path(arguments.light.cubemap).filename().string(),
                         relight::rig_weights(environment, rig).weights});
  }
  if (!arguments.light.lights.empty()) {
    lightings.push_back(
        {"--light", relight::weights_from_words(arguments.light.lights, rig.n_lights())});
  }
  return lightings;
}

ExitCode run_advise(const AdviseArguments& arguments, const CommonOptions& common,
                    Report& report) {
  report.add_input(arguments.rig);
  report.add_requested("target_db", arguments.advice.target_db);
  report.add_requested("flicker", arguments.advice.flicker);
  if (!arguments.output.empty()) {
    require_absent(arguments.output, common.force);
  }
  const Rig rig = read_rig(arguments.rig);
  const capture::AdviceScene scene = scene_of(arguments, rig, common, report);
  const std::vector<capture::AdviceLighting> lightings = lightings_of(arguments, rig, report);
  const bool has_own = lightings.size() > 1;
  const capture::Lighting own{has_own ? lightings[1].weights : Eigen::MatrixXd(), {}};
  std::vector<capture::PlanSettings> families = capture::default_families(rig, has_own);
  for (capture::PlanSettings& family : families) {
    family.wavelets = arguments.wavelets;
  }
  const capture::Advice advice = capture::advise(rig, scene, lightings, families,
                                                 has_own ? &own : nullptr, arguments.advice);
  fmt::print("{}", capture::advice_text(rig, scene, advice, arguments.advice.target_db));
  capture::add_to_report(advice, report);
  if (advice.best < 0) {
    return ExitCode::target_missed;
  }
  if (!arguments.output.empty()) {
    const std::string json =
        capture::plan_to_json(advice.families[static_cast<std::size_t>(advice.best)].plan);
    write_file_atomically(arguments.output, json);
    report.set_bytes(json.size());
  }
  return ExitCode::done;
}

}  // namespace

void add_advise(Command root, Invocation& invocation) {
  auto arguments = std::make_shared<AdviseArguments>();
  Command verb = root.add_verb("advise", "Say which patterns pay on a rig, and which don't");
  verb.option("RIG", &arguments->rig, "Rig file, with the camera's noise",
              {.type = "RIG.toml", .is_required = true});
  verb.option("--signal", &arguments->signal_e,
              "Electrons of a lit pixel of the plane under one light at the rig's exposure",
              {.type = "E", .bounds = Bounds{1e-3, 1e9}});
  verb.option("--pilot", &arguments->pilot,
              "An earlier session of this object or one like it, every light on its own: its "
              "signal, and what blocks of lights would hide",
              {.type = "SESSION"});
  add_light_options(verb, arguments->light);
  verb.option("--target", &arguments->advice.target_db,
              "Wanted PSNR in dB under every lighting: the fastest way there is advised",
              {.bounds = Bounds{0.0, 200.0}, .shows_default = true});
  verb.option("--flicker", &arguments->advice.flicker,
              "Relative rms by which one light's output differs from shot to shot",
              {.bounds = Bounds{0.0, 1.0}, .shows_default = true});
  verb.option("--wavelets", &arguments->wavelets, "How many wavelets lighting_haar keeps",
              {.bounds = Bounds{1, 1e6}, .shows_default = true});
  verb.option("-o", &arguments->output, "Write the advised shot list", {.type = "plan.json"});
  verb.footer(
      "Marks: * advised, x refused, with the reason. PSNR: of a relit picture against the\n"
      "noise-free one, peak = its 99.9th percentile. docs/numerics/patterns.md says more.\n"
      "Example:\n"
      "  haarlight advise configs/rigs/cube32.toml --signal 800 --cubemap "
      "configs/environments/room.hdr");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_advise(*arguments, common, report);
  });
}

}  // namespace haarlight::apps
