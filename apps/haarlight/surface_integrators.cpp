// SPDX-License-Identifier: Apache-2.0

#include "apps/haarlight/surface_integrators.h"

#include <string>
#include <utility>

#include "haarlight/core/error.h"
#include "render/camera/camera.h"
#include "render/surface/whitted_integrator.h"

namespace haarlight::apps {

namespace {

/// Whether it follows one camera ray at a time, and asks all lights by a point of each.
constexpr bool is_by_rays(IntegratorKind kind) {
  return kind == IntegratorKind::ray_casting || kind == IntegratorKind::whitted;
}

/// What integrators that follow one camera ray at a time take of them.
render::RayOptions ray_options(const render::PathOptions& options) {
  return {.sampler = options.sampler,
          .seed = options.seed,
          .filter = options.filter,
          .has_features = options.has_features,
          .first_x = options.first_x,
          .first_y = options.first_y};
}

[[noreturn]] void refuse(const char* what, const char* option, const char* hint) {
  throw Error(what, option, hint, ExitCode::usage);
}

}  // namespace

void add_integrator_options(Command& verb, IntegratorArguments& arguments) {
  verb.option(
      "--integrator", &arguments.kind,
      "path: all light; direct: what arrives without a bounce; whitted: that, also over "
      "mirrors and glass; ray-casting: by a point of each light alone",
      {.choices = choices_of({IntegratorKind::ray_casting, IntegratorKind::whitted,
                              IntegratorKind::direct, IntegratorKind::path}),
       .shows_default = true});
  verb.option(
      "--lights", &arguments.lights,
      "Which lights are asked at a point: power: one, by its power; tree: one, by what it "
      "could contribute there; uniform: one, all alike; all: each of them",
      {.shows_default = true});
  verb.option(
      "--sampling", &arguments.sampling,
      "How light is found: light: by points of the lights; bsdf: by directions in which "
      "the surface reflects; mis: by both, weighted",
      {.shows_default = true});
  verb.option(
      "--bounces", &arguments.most_bounces,
      "Longest paths of --integrator path and whitted (default: 64); longer ones are left out",
      {.bounds = Bounds{0, 1 << 16}});
  verb.option(
      "--sampler", &arguments.sampler,
      "How samples are spread: sobol and halton evenly, stratified one in each sixteenth of "
      "every 16, independent at random",
      {.shows_default = true});
  verb.option("--filter", &arguments.filter,
              "How a pixel weighs what is around its centre: box, the pixel; gaussian, softer; "
              "mitchell, sharper (default: the scene's [film], else box)");
  verb.option("--seed", &arguments.seed, "Of the samples", {.shows_default = true});
}

void require_integrator_words(const IntegratorArguments& arguments, bool explains) {
  if (arguments.most_bounces && (arguments.kind == IntegratorKind::direct ||
                                 arguments.kind == IntegratorKind::ray_casting)) {
    refuse("this --integrator has no longer paths", "--bounces",
           "leave it out, or give --integrator path or whitted");
  }
  if (is_by_rays(arguments.kind)) {
    if (arguments.sampling == render::DirectSampling::bsdf) {
      refuse("this --integrator finds light by points of the lights alone", "--sampling",
             "leave it out, or give --integrator path or direct");
    }
    if (arguments.lights == render::LightChoice::uniform ||
        arguments.lights == render::LightChoice::power) {
      refuse("this --integrator asks all lights", "--lights",
             "leave it out, or give --integrator path or direct");
    }
    if (explains) {
      refuse("--explain tells what path tracing leaves out", "--explain",
             "give --integrator path or direct");
    }
  }
}

void report_integrator(const IntegratorArguments& arguments, Report& report) {
  report.add_requested("integrator", std::string(to_string(arguments.kind)));
  report.add_requested(
      "lights", std::string(to_string(is_by_rays(arguments.kind) ? render::LightChoice::all
                                                                 : arguments.lights)));
  report.add_requested("sampling", std::string(to_string(is_by_rays(arguments.kind)
                                                             ? render::DirectSampling::light
                                                             : arguments.sampling)));
  report.add_requested("sampler", std::string(to_string(arguments.sampler)));
}

render::PathOptions path_options(const IntegratorArguments& arguments,
                                 const render::FilmSettings& film, const render::Crop& crop,
                                 bool has_features) {
  const bool by_rays = is_by_rays(arguments.kind);
  render::PathOptions options;
  options.lights = by_rays ? render::LightChoice::all : arguments.lights;
  options.sampling = by_rays ? render::DirectSampling::light : arguments.sampling;
  switch (arguments.kind) {
    case IntegratorKind::ray_casting:
      options.most_bounces = 0;
      break;
    case IntegratorKind::direct:
      options.most_bounces = 1;
      break;
    case IntegratorKind::whitted:
    case IntegratorKind::path:
      options.most_bounces = arguments.most_bounces.value_or(options.most_bounces);
  }
  options.sampler = arguments.sampler;
  options.seed = arguments.seed;
  options.filter = arguments.filter.value_or(film.filter.value_or(options.filter));
  options.has_features = has_features;
  options.first_x = crop.x;
  options.first_y = crop.y;
  return options;
}

render::RenderSettings integrator_settings(const IntegratorArguments& arguments,
                                           const render::PathOptions& options) {
  return {{"integrator", std::string(to_string(arguments.kind))},
          {"bounces", std::to_string(options.most_bounces)},
          {"lights", std::string(to_string(options.lights))},
          {"sampling", std::string(to_string(options.sampling))},
          {"sampler", std::string(to_string(options.sampler))},
          {"filter", std::string(to_string(options.filter))},
          {"seed", std::to_string(options.seed)}};
}

std::unique_ptr<render::TileRenderer> make_integrator(const IntegratorArguments& arguments,
                                                      const render::SceneFile& file,
                                                      const render::RayCaster& caster,
                                                      const render::Environment* environment,
                                                      const render::PathOptions& options) {
  render::Camera camera(file.camera, file.optics);
  switch (arguments.kind) {
    case IntegratorKind::ray_casting:
    case IntegratorKind::whitted:
      return std::make_unique<render::WhittedIntegrator>(
          file.scene, caster, environment, std::move(camera),
          render::WhittedOptions{.ray = ray_options(options),
                                 .most_bounces = options.most_bounces});
    case IntegratorKind::direct:
    case IntegratorKind::path:
      break;
  }
  return std::make_unique<render::PathIntegrator>(file.scene, caster, environment,
                                                  std::move(camera), options);
}

}  // namespace haarlight::apps
