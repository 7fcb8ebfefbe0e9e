// SPDX-License-Identifier: Apache-2.0

#include "apps/haarlight/surface_integrators.h"

#include <array>
#include <chrono>
#include <cstddef>
#include <optional>
#include <string>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "render/camera/camera.h"
#include "render/radiosity/radiosity_integrator.h"
#include "render/surface/bidirectional_integrator.h"
#include "render/surface/irradiance_cache.h"
#include "render/surface/path_baselines.h"
#include "render/surface/whitted_integrator.h"

namespace haarlight::apps {

namespace {

/// What an integrator takes of the command line, and what it has.
struct Abilities {
  IntegratorKind kind = IntegratorKind::path;
  std::optional<int> bounces;  ///< of its longest paths; nothing: any number, --bounces says it
  bool is_by_rays = false;  ///< one camera ray at a time; asks all lights, by a point of each
  bool weighs_all_ways = false;  ///< to find light: --sampling has no meaning
  bool has_splats = false;
  bool is_explained = false;  ///< --explain tells of it
};

/// In the order of IntegratorKind.
constexpr auto kAbilities = std::to_array<Abilities>({
    {.kind = IntegratorKind::ray_casting, .bounces = 0, .is_by_rays = true},
    {.kind = IntegratorKind::whitted, .is_by_rays = true},
    {.kind = IntegratorKind::direct, .bounces = 1, .is_explained = true},
    {.kind = IntegratorKind::path, .is_explained = true},
    {.kind = IntegratorKind::bidirectional, .weighs_all_ways = true, .has_splats = true},
    {.kind = IntegratorKind::path_naive, .is_by_rays = true},
    {.kind = IntegratorKind::path_by_area, .is_by_rays = true},
    {.kind = IntegratorKind::irradiance_cache},
    {.kind = IntegratorKind::photon_map, .weighs_all_ways = true},
    {.kind = IntegratorKind::radiosity, .bounces = 0, .is_by_rays = true},
    {.kind = IntegratorKind::automatic, .is_explained = true},
});
static_assert(kAbilities.size() == kIntegratorWords.size());

constexpr const Abilities& abilities_of(IntegratorKind kind) {
  return kAbilities.at(static_cast<std::size_t>(kind));
}

constexpr bool is_in_order() {
  for (std::size_t i = 0; i < kAbilities.size(); ++i) {
    if (static_cast<std::size_t>(kAbilities.at(i).kind) != i) {
      return false;
    }
  }
  return true;
}
static_assert(is_in_order());

/// The numbers of a new path for each length are as many as the square of these.
constexpr int kMostNaiveBounces = 1000;

render::LightChoice asked_lights(const IntegratorArguments& arguments) {
  return abilities_of(arguments.kind).is_by_rays ? render::LightChoice::all : arguments.lights;
}

render::DirectSampling asked_sampling(const IntegratorArguments& arguments) {
  return abilities_of(arguments.kind).is_by_rays ? render::DirectSampling::light
                                                 : arguments.sampling;
}

/// What integrators that follow one camera ray at a time take of them.
render::RayOptions ray_options(const render::PathOptions& options) {
  return {.lights = options.lights,
          .sampler = options.sampler,
          .seed = options.seed,
          .filter = options.filter,
          .has_features = options.has_features,
          .first_x = options.first_x,
          .first_y = options.first_y};
}

render::RadiosityOptions radiosity_options(const IntegratorArguments& arguments) {
  render::RadiosityOptions options{.seed = arguments.seed};
  if (arguments.patches) {
    options.patches = static_cast<std::size_t>(*arguments.patches);
  }
  if (arguments.form_factor_rays) {
    options.rays = static_cast<std::uint32_t>(*arguments.form_factor_rays);
  }
  return options;
}

render::IrradianceCacheOptions cache_options(const IntegratorArguments& arguments) {
  render::IrradianceCacheOptions options;
  options.accuracy = arguments.accuracy.value_or(options.accuracy);
  options.gather_rays = arguments.gather_rays.value_or(options.gather_rays);
  return options;
}

std::unique_ptr<render::TileRenderer> make_irradiance_cache(
    const IntegratorArguments& arguments, const render::SceneFile& file,
    const render::RayCaster& caster, const render::Environment* environment,
    const render::PathOptions& path, const Preparation& preparation) {
  render::IrradianceCacheOptions options = cache_options(arguments);
  options.memory_bytes = preparation.memory_bytes;
  options.is_stopped = preparation.is_stopped;
  const auto start = std::chrono::steady_clock::now();
  auto made = std::make_unique<render::IrradianceCacheIntegrator>(
      file.scene, caster, environment, render::Camera(file.camera, file.optics), path, options);
  const double seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  const double foretold = made->leave_one_out();
  if (preparation.report == nullptr) {
    return made;
  }
  Report& report = *preparation.report;
  report.add_detail("is_biased", true);
  report.add_detail("cache_records", static_cast<std::int64_t>(made->cache().records().size()));
  report.add_detail("cache_rays", static_cast<std::int64_t>(made->cache_rays()));
  report.add_detail("cache_seconds", seconds);
  report.add_detail("cache_leave_one_out", foretold);
  fmt::print(
      "irradiance cache: {} records, {:.1f} million rays in {:.1f} s; biased: light "
      "between matte surfaces is interpolated, each record differs by {:.2g} from what "
      "the others tell there\n",
      made->cache().records().size(), 1e-6 * static_cast<double>(made->cache_rays()), seconds,
      foretold);
  return made;
}

render::PhotonMapOptions photon_options(const IntegratorArguments& arguments,
                                        const render::PathOptions& options,
                                        std::uint64_t most_bytes) {
  render::PhotonMapOptions made{.ray = ray_options(options),
                                .most_bounces = options.most_bounces,
                                .has_final_gather = arguments.photon_map.has_final_gather};
  made.photons.photons = static_cast<std::uint32_t>(
      arguments.photon_map.photons.value_or(static_cast<int>(made.photons.photons)));
  made.photons.nearest = arguments.photon_map.nearest.value_or(made.photons.nearest);
  made.photons.kernel = arguments.photon_map.kernel.value_or(made.photons.kernel);
  made.photons.most_bytes = most_bytes;
  made.gather_rays = static_cast<std::uint32_t>(
      arguments.gather_rays.value_or(static_cast<int>(made.gather_rays)));
  return made;
}

[[noreturn]] void refuse(const char* what, const char* option, const char* hint) {
  throw Error(what, option, hint, ExitCode::usage);
}

/// An option that has a meaning for some integrators alone.
struct OwnOption {
  const char* option;
  bool (*is_given)(const IntegratorArguments& arguments);
  bool (*is_taken)(IntegratorKind kind);
  const char* problem;
  const char* hint;
};

constexpr bool is_photon_map(IntegratorKind kind) { return kind == IntegratorKind::photon_map; }
constexpr bool is_radiosity(IntegratorKind kind) { return kind == IntegratorKind::radiosity; }
constexpr bool is_cache(IntegratorKind kind) {
  return kind == IntegratorKind::irradiance_cache;
}
constexpr const char* kNoPhotons = "no other integrator has photons";
constexpr const char* kGivePhotonMap = "leave it out, or give --integrator photon-map";
constexpr const char* kGivePath = "leave it out, or give --integrator path or direct";

constexpr auto kOwnOptions = std::to_array<OwnOption>({
    {"--photons", [](const auto& given) { return given.photon_map.photons.has_value(); },
     is_photon_map, kNoPhotons, kGivePhotonMap},
    {"--nearest", [](const auto& given) { return given.photon_map.nearest.has_value(); },
     is_photon_map, kNoPhotons, kGivePhotonMap},
    {"--kernel", [](const auto& given) { return given.photon_map.kernel.has_value(); },
     is_photon_map, kNoPhotons, kGivePhotonMap},
    {"--final-gather", [](const auto& given) { return given.photon_map.has_final_gather; },
     is_photon_map, kNoPhotons, kGivePhotonMap},
    {"--accuracy", [](const auto& given) { return given.accuracy.has_value(); }, is_cache,
     "this --integrator has no irradiance cache",
     "leave it out, or give --integrator irradiance-cache"},
    {"--gather-rays", [](const auto& given) { return given.gather_rays.has_value(); },
     [](IntegratorKind kind) { return is_cache(kind) || is_photon_map(kind); },
     "this --integrator gathers nothing",
     "leave it out, or give --integrator irradiance-cache or photon-map"},
    {"--patches", [](const auto& given) { return given.patches.has_value(); }, is_radiosity,
     "only radiosity has patches", "leave it out, or give --integrator radiosity"},
    {"--form-factor-rays", [](const auto& given) { return given.form_factor_rays.has_value(); },
     is_radiosity, "only radiosity has patches",
     "leave it out, or give --integrator radiosity"},
});

/// Refuses ways to choose lights and to find them that the integrator does not have.
void require_light_words(const IntegratorArguments& arguments, const Abilities& has) {
  const render::LightChoice lights = arguments.lights;
  if (has.weighs_all_ways && arguments.sampling != render::DirectSampling::mis) {
    refuse(is_photon_map(has.kind) ? "photon maps find light by their own ways"
                                   : "this --integrator weighs all ways to find light",
           "--sampling", kGivePath);
  }
  if (has.kind == IntegratorKind::bidirectional && lights == render::LightChoice::all) {
    refuse("this --integrator asks one light at each point", "--lights",
           "give --lights tree, power or uniform, or --integrator path");
  }
  if (has.is_by_rays && arguments.sampling == render::DirectSampling::bsdf) {
    refuse("this --integrator finds light by points of the lights alone", "--sampling",
           kGivePath);
  }
  if (has.is_by_rays &&
      (lights == render::LightChoice::uniform || lights == render::LightChoice::power)) {
    refuse("this --integrator asks all lights", "--lights", kGivePath);
  }
  if (is_photon_map(has.kind) && !arguments.photon_map.has_final_gather) {
    if (arguments.gather_rays) {
      refuse("only a final gather has rays", "--gather-rays", "give --final-gather, too");
    }
    if (lights != render::PathOptions{}.lights) {
      refuse("without a final gather no light is asked", "--lights",
             "give --final-gather, too");
    }
  }
}

}  // namespace

void add_integrator_options(Command& verb, IntegratorArguments& arguments) {
  verb.option(
      "--integrator", &arguments.kind,
      "path: all light; bidirectional: the same, by paths from the lights, too; direct: what "
      "arrives without a bounce; whitted: that, also over mirrors and glass; ray-casting: by a "
      "point of each light alone; radiosity: all light of matte surfaces, on patches; "
      "irradiance-cache: all light, that between matte surfaces "
      "interpolated; photon-map: all light, by rays that the lights shoot; path-naive, "
      "path-by-area: for comparing with path; auto: path, bidirectional or direct, their "
      "--lights and --sampling by a short pilot, with the reason",
      {.choices = choices_of({IntegratorKind::ray_casting, IntegratorKind::whitted,
                              IntegratorKind::direct, IntegratorKind::path,
                              IntegratorKind::bidirectional, IntegratorKind::path_naive,
                              IntegratorKind::path_by_area, IntegratorKind::radiosity,
                              IntegratorKind::irradiance_cache, IntegratorKind::photon_map,
                              IntegratorKind::automatic}),
       .shows_default = true});
  verb.option(
      "--lights", &arguments.given_lights,
      "Which lights are asked at a point: power: one, by its power; tree: one, by what it "
      "could contribute there; uniform: one, all alike; all: each of them",
      {.default_text = std::string(to_string(arguments.lights))});
  verb.option(
      "--sampling", &arguments.given_sampling,
      "How light is found: light: by points of the lights; bsdf: by directions in which "
      "the surface reflects; mis: by both, weighted",
      {.default_text = std::string(to_string(arguments.sampling))});
  verb.option("--bounces", &arguments.most_bounces,
              "Longest paths (default: 64); longer ones are left out",
              {.bounds = Bounds{0, 1 << 16}});
  verb.option("--patches", &arguments.patches,
              "Of --integrator radiosity: into how many the triangles are cut (default: 10000)",
              {.bounds = Bounds{1, 1 << 24}});
  verb.option("--form-factor-rays", &arguments.form_factor_rays,
              "Of --integrator radiosity: rays of each side of a patch (default: 1024)",
              {.bounds = Bounds{1, 1 << 20}});
  verb.option("--accuracy", &arguments.accuracy,
              "Of --integrator irradiance-cache: a record serves up to A times the distance of "
              "what it sees: smaller is slower and better (default: 0.3)",
              {.type = "A", .bounds = Bounds{0.01, 10.0}});
  verb.option(
      "--gather-rays", &arguments.gather_rays,
      "Of --integrator irradiance-cache: paths for each record (default: 512); of photon-map "
      "--final-gather: rays of each sample (default: 4)",
      {.bounds = Bounds{1, 1 << 20}});
  verb.option(
      "--sampler", &arguments.sampler,
      "How samples are spread: sobol and halton evenly, stratified one in each sixteenth of "
      "every 16, independent at random",
      {.shows_default = true});
  verb.option("--filter", &arguments.filter,
              "How a pixel weighs what is around its centre: box, the pixel; gaussian, softer; "
              "mitchell, sharper (default: the scene's [film], else box)");
  verb.option("--seed", &arguments.seed, "Of the samples", {.shows_default = true});
  PhotonArguments& photons = arguments.photon_map;
  verb.option("--photons", &photons.photons,
              "Rays that the lights shoot for --integrator photon-map (default: 400000)",
              {.type = "N", .bounds = Bounds{1, 1 << 30}});
  verb.option("--nearest", &photons.nearest,
              "Photons that tell the light at a point of it (default: 50)",
              {.type = "K", .bounds = Bounds{2, 1 << 20}});
  verb.option("--kernel", &photons.kernel,
              "How they are weighed: constant, without the one that sets the radius (default); "
              "epanechnikov: less outwards; slides: all alike, K/(K - 1) too much");
  verb.flag(
      "--final-gather", &photons.has_final_gather,
      "Only caustics are looked up directly: other light between surfaces by rays to where "
      "it comes from");
}

void take_given(IntegratorArguments& arguments) {
  arguments.lights = arguments.given_lights.value_or(arguments.lights);
  arguments.sampling = arguments.given_sampling.value_or(arguments.sampling);
}

void require_integrator_words(const IntegratorArguments& arguments, bool explains) {
  const Abilities& has = abilities_of(arguments.kind);
  for (const OwnOption& own : kOwnOptions) {
    if (own.is_given(arguments) && !own.is_taken(has.kind)) {
      refuse(own.problem, own.option, own.hint);
    }
  }
  if (arguments.most_bounces && has.bounces) {
    refuse(is_radiosity(has.kind) ? "radiosity has all bounces at once"
                                  : "this --integrator has no longer paths",
           "--bounces", "leave it out, or give --integrator path or whitted");
  }
  if (has.kind == IntegratorKind::path_naive &&
      arguments.most_bounces.value_or(0) > kMostNaiveBounces) {
    refuse("a new path for each number of bounces", "--bounces", "give at most 1000");
  }
  require_light_words(arguments, has);
  if (explains && !has.is_explained) {
    refuse("--explain tells what path tracing leaves out", "--explain",
           "give --integrator path or direct");
  }
}

void report_integrator(const IntegratorArguments& arguments, Report& report) {
  report.add_requested("integrator", std::string(to_string(arguments.kind)));
  report.add_requested("sampler", std::string(to_string(arguments.sampler)));
  if (arguments.kind == IntegratorKind::automatic) {
    if (arguments.given_lights) {
      report.add_requested("lights", std::string(to_string(*arguments.given_lights)));
    }
    if (arguments.given_sampling) {
      report.add_requested("sampling", std::string(to_string(*arguments.given_sampling)));
    }
    return;
  }
  report.add_requested("lights", std::string(to_string(asked_lights(arguments))));
  report.add_requested("sampling", std::string(to_string(asked_sampling(arguments))));
}

render::PathOptions path_options(const IntegratorArguments& arguments,
                                 const render::FilmSettings& film, const render::Crop& crop,
                                 bool has_features) {
  HAARLIGHT_EXPECTS(arguments.kind != IntegratorKind::automatic, "auto has chosen");
  render::PathOptions options;
  options.lights = asked_lights(arguments);
  options.sampling = asked_sampling(arguments);
  options.most_bounces =
      abilities_of(arguments.kind)
          .bounces.value_or(arguments.most_bounces.value_or(options.most_bounces));
  options.sampler = arguments.sampler;
  options.seed = arguments.seed;
  options.filter = arguments.filter.value_or(film.filter.value_or(options.filter));
  options.has_features = has_features;
  options.first_x = crop.x;
  options.first_y = crop.y;
  return options;
}

bool has_splats(const IntegratorArguments& arguments) {
  return abilities_of(arguments.kind).has_splats;
}

render::RenderSettings integrator_settings(const IntegratorArguments& arguments,
                                           const render::PathOptions& options) {
  render::RenderSettings settings{{"integrator", std::string(to_string(arguments.kind))},
                                  {"bounces", std::to_string(options.most_bounces)},
                                  {"lights", std::string(to_string(options.lights))},
                                  {"sampling", std::string(to_string(options.sampling))},
                                  {"sampler", std::string(to_string(options.sampler))},
                                  {"filter", std::string(to_string(options.filter))},
                                  {"seed", std::to_string(options.seed)}};
  if (arguments.kind == IntegratorKind::irradiance_cache) {
    const render::IrradianceCacheOptions cache = cache_options(arguments);
    settings.emplace_back("accuracy", fmt::format("{}", cache.accuracy));
    settings.emplace_back("gather_rays", std::to_string(cache.gather_rays));
  }
  if (arguments.kind == IntegratorKind::radiosity) {
    const render::RadiosityOptions radiosity = radiosity_options(arguments);
    settings.emplace_back("patches", std::to_string(radiosity.patches));
    settings.emplace_back("form factor rays", std::to_string(radiosity.rays));
  }
  if (arguments.kind == IntegratorKind::photon_map) {
    const render::PhotonMapOptions photons = photon_options(arguments, options, 0);
    settings.emplace_back("photons", std::to_string(photons.photons.photons));
    settings.emplace_back("nearest", std::to_string(photons.photons.nearest));
    settings.emplace_back("kernel", std::string(to_string(photons.photons.kernel)));
    settings.emplace_back(
        "gather_rays", photons.has_final_gather ? std::to_string(photons.gather_rays) : "none");
  }
  return settings;
}

std::uint64_t integrator_bytes(const IntegratorArguments& arguments, const render::Scene& scene,
                               const std::string& path) {
  if (arguments.kind != IntegratorKind::radiosity) {
    return 0;
  }
  try {
    render::require_diffuse(scene);
  } catch (const Error& error) {
    throw Error(error.problem(), path + ": " + error.where(), error.hint(), error.code());
  }
  return render::PatchLight::bytes_needed(scene, radiosity_options(arguments));
}

std::unique_ptr<render::TileRenderer> make_integrator(const IntegratorArguments& arguments,
                                                      const render::SceneFile& file,
                                                      const render::RayCaster& caster,
                                                      const render::Environment* environment,
                                                      const render::PathOptions& options,
                                                      const Preparation& preparation) {
  render::Camera camera(file.camera, file.optics);
  switch (arguments.kind) {
    case IntegratorKind::ray_casting:
    case IntegratorKind::whitted:
      return std::make_unique<render::WhittedIntegrator>(
          file.scene, caster, environment, std::move(camera),
          render::WhittedOptions{.ray = ray_options(options),
                                 .most_bounces = options.most_bounces});
    case IntegratorKind::path_naive:
      return std::make_unique<render::NaivePathIntegrator>(
          file.scene, caster, environment, std::move(camera),
          render::PathBaselineOptions{.ray = ray_options(options),
                                      .most_bounces = options.most_bounces});
    case IntegratorKind::path_by_area:
      return std::make_unique<render::AreaPathIntegrator>(
          file.scene, caster, environment, std::move(camera),
          render::PathBaselineOptions{.ray = ray_options(options),
                                      .most_bounces = options.most_bounces});
    case IntegratorKind::radiosity:
      return std::make_unique<render::RadiosityIntegrator>(
          file.scene, caster, environment, std::move(camera), ray_options(options),
          render::PatchLight(file.scene, caster, environment, radiosity_options(arguments)));
    case IntegratorKind::bidirectional:
      return std::make_unique<render::BidirectionalIntegrator>(
          file.scene, caster, environment, std::move(camera),
          render::BidirectionalOptions{
              .most_bounces = options.most_bounces,
              .lights = options.lights,
              .sampler = options.sampler,
              .seed = options.seed,
              .filter = options.filter,
              .has_features = options.has_features,
              .first_x = options.first_x,
              .first_y = options.first_y,
              .width = preparation.crop.width,
              .height = preparation.crop.height,
              .tells_of_path_tracing = preparation.tells_of_path_tracing});
    case IntegratorKind::irradiance_cache:
      return make_irradiance_cache(arguments, file, caster, environment, options, preparation);
    case IntegratorKind::photon_map:
      return std::make_unique<render::PhotonMapIntegrator>(
          file.scene, caster, environment, std::move(camera),
          photon_options(arguments, options, preparation.memory_bytes));
    case IntegratorKind::direct:
    case IntegratorKind::path:
    case IntegratorKind::automatic:
      break;
  }
  return std::make_unique<render::PathIntegrator>(file.scene, caster, environment,
                                                  std::move(camera), options);
}

}  // namespace haarlight::apps
