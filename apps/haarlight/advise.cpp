// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight advise RIG`: which patterns pay, with the arithmetic.

#include <cmath>

#include <fmt/format.h>

#include "apps/haarlight/light_options.h"
#include "apps/haarlight/verb.h"
#include "capture/plan/advice.h"
#include "capture/plan/advice_pilot.h"
#include "core/files.h"
#include "core/rig/rig.h"
#include "relight/basis/compress_session.h"
#include "relight/basis/plate/plate.h"
#include "relight/basis/weight_list.h"
#include "relight/light/light_weights.h"
#include "session/develop/develop.h"

namespace haarlight {

namespace {

struct AdviseArguments {
  std::string rig;
  std::optional<double> signal_e;
  std::string pilot;
  LightChoice light;
  double target_db = 0.0;
  double flicker = 0.0;
  int wavelets = 64;
  std::string output;
};

constexpr int kMaxPixels = 2048;  // the mean over them is within 3 % of all pixels' (1/sqrt)
constexpr int kSingleLights = 16;

/// The computed plate at a sample of pixels.
std::vector<float> plate_sample(const Rig& rig) {
  const ComputedPlate plate(rig);
  const StackDims dims = plate.dims();
  const std::size_t n = dims.n_pixels();
  const std::size_t n_kept = std::min<std::size_t>(n, kMaxPixels);
  const auto n_lights = static_cast<std::size_t>(dims.n_lights);
  std::vector<float> values(n_kept * n_lights);
  for (std::size_t i = 0; i < n_kept; ++i) {
    const auto pixel = static_cast<int>(i * n / n_kept);
    plate.read_tile({pixel % dims.width, pixel / dims.width, 1, 1},
                    std::span(values).subspan(i * n_lights, n_lights));
  }
  return values;
}

AdviceScene scene_of(const AdviseArguments& arguments, const Rig& rig,
                     const CommonOptions& common, Report& report) {
  if (arguments.pilot.empty()) {
    if (!arguments.signal_e) {
      throw Error("how bright is a light?", "haarlight advise",
                  "give --signal ELECTRONS of a lit pixel under one light, or --pilot SESSION",
                  ExitCode::usage);
    }
    report.add_asked("signal_e", *arguments.signal_e);
    return plate_scene(plate_sample(rig), rig.n_lights(), *arguments.signal_e);
  }
  report.add_input(arguments.pilot);
  const Session session = Session::open(arguments.pilot);
  DevelopOptions options;
  options.memory_bytes = common.memory_bytes;
  options.progress = common.progress();
  options.keep_bayer = true;  // the noise of single pixels, not of their averages
  options.plate = sharing_plate(session, {});
  const LightStack stack = develop(session, options);
  if (stack.dims().n_lights != rig.n_lights()) {
    throw Error(fmt::format("the pilot has {} lights, the rig {}", stack.dims().n_lights,
                            rig.n_lights()),
                arguments.pilot, "use a session of this rig");
  }
  // The plate that develop will use, whether or not the pilot itself needed one.
  PlatePixels plate;
  const int camera = camera_of_size(rig, stack.dims().width, stack.dims().height);
  if (!rig.planes.empty() && camera >= 0) {
    const auto computed = std::make_shared<const ComputedPlate>(rig, camera);
    plate.read = [computed](int y, int x0, int x1, std::span<float> out) {
      computed->read_tile({x0, y, x1 - x0, 1}, out);
    };
  }
  return pilot_scene(session, stack, rig.cameras.front(), plate, kMaxPixels);
}

std::string db(double value) { return std::isnan(value) ? "?" : fmt::format("{:.1f}", value); }

void print_family(const FamilyAdvice& family, bool is_best) {
  fmt::print("{} {:<16}", is_best ? "*" : family.refusals.empty() ? " " : "x", family.name);
  if (family.predictions.empty()) {
    fmt::print("\n");
  } else {
    fmt::print("{:>6} shots {:>8.1f} s {:>10.1f} us {:>8.1f} W\n", family.cost.n_shots,
               family.cost.seconds, family.exposure_us, family.cost.peak_watts);
  }
  for (const Prediction& p : family.predictions) {
    const double bias_db = 20.0 * std::log10(p.peak_e / p.bias_e);
    fmt::print("      {:<22} {:>6} dB   noise alone {:>6} dB, bias alone {:>6} dB\n",
               p.lighting, db(p.psnr_db), db(p.noise_psnr_db),
               p.bias_e == 0.0 ? std::string("none") : db(bias_db));
  }
  for (const std::string& note : family.notes) {
    fmt::print("      {}\n", note);
  }
  for (const std::string& refusal : family.refusals) {
    fmt::print("      refused: {}\n", refusal);
  }
}

void report_family(const FamilyAdvice& family, Report& report) {
  const std::string head = "advice." + family.name + ".";
  report.add_detail(head + "shots", std::int64_t{family.cost.n_shots});
  report.add_detail(head + "seconds", family.cost.seconds);
  report.add_detail(head + "exposure_us", family.exposure_us);
  report.add_detail(head + "peak_watts", family.cost.peak_watts);
  for (std::size_t i = 0; i < family.refusals.size(); ++i) {
    report.add_detail(fmt::format("{}refused.{}", head, i), family.refusals[i]);
  }
  for (const Prediction& p : family.predictions) {
    const auto add = [&](const char* key, double value) {
      if (std::isfinite(value)) {
        report.add_detail(fmt::format("{}{}.{}", head, p.lighting, key), value);
      }
    };
    add("psnr_db", p.psnr_db);
    add("noise_psnr_db", p.noise_psnr_db);
    add("peak_e", p.peak_e);
    add("noise_e", p.noise_e);
    add("bias_e", p.bias_e);
  }
}

ExitCode run_advise(const AdviseArguments& arguments, const CommonOptions& common,
                    Report& report) {
  report.add_input(arguments.rig);
  report.add_asked("target_db", arguments.target_db);
  report.add_asked("flicker", arguments.flicker);
  if (!arguments.output.empty()) {
    require_absent(arguments.output, common.force);
  }
  const Rig rig = read_rig(arguments.rig);
  const AdviceScene scene = scene_of(arguments, rig, common, report);
  std::vector<AdviceLighting> lightings{single_lights(rig.n_lights(), kSingleLights)};
  std::optional<Lighting> own;
  if (!arguments.light.cubemap.empty()) {
    const Environment environment = read_environment(arguments.light);
    report.add_input(arguments.light.cubemap);
    report.add_asked("rotate_deg", arguments.light.rotate_deg);
    report.add_detail("layout", std::string(to_string(environment.layout())));
    own = Lighting{rig_weights(environment, rig).weights, {}};
    lightings.push_back(
        {std::filesystem::path(arguments.light.cubemap).filename().string(), own->weights});
  }
  if (!arguments.light.lights.empty()) {
    lightings.push_back(
        {"--light", weights_from_words(arguments.light.lights, rig.n_lights())});
    if (!own) {
      own = Lighting{lightings.back().weights, {}};
    }
  }
  std::vector<PlanSettings> families = default_families(rig, own.has_value());
  for (PlanSettings& family : families) {
    family.wavelets = arguments.wavelets;
  }
  AdviceOptions options;
  options.flicker = arguments.flicker;
  options.target_db = arguments.target_db;
  const Advice advice = advise(rig, scene, lightings, families, own ? &*own : nullptr, options);
  fmt::print("rig \"{}\", signal from {}\n", rig.name, scene.source);
  if (!scene.resolves_lights) {
    fmt::print(
        "bias \"?\": what a block of lights hides is not known without a pilot that lit "
        "every light (--pilot SESSION)\n");
  }
  for (std::size_t i = 0; i < advice.families.size(); ++i) {
    print_family(advice.families[i], static_cast<int>(i) == advice.best);
    report_family(advice.families[i], report);
  }
  if (advice.best < 0) {
    fmt::print("none of them {}\n", arguments.target_db > 0.0
                                        ? fmt::format("reaches {:.1f} dB", arguments.target_db)
                                        : "may be used");
    return ExitCode::target_missed;
  }
  const FamilyAdvice& best = advice.families[static_cast<std::size_t>(advice.best)];
  report.add_reached("best", best.name);
  fmt::print("* {}: {}\n", best.name,
             arguments.target_db > 0.0 ? "the fastest that reaches the target"
                                       : "the best under the worst lighting");
  if (!arguments.output.empty()) {
    const std::string json = plan_to_json(best.plan);
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
  verb.option("--target", &arguments->target_db,
              "Wanted PSNR in dB under every lighting: the fastest way there is advised",
              {.bounds = Bounds{0.0, 200.0}, .shows_default = true});
  verb.option("--flicker", &arguments->flicker,
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

}  // namespace haarlight
