// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "apps/command_line.h"
#include "core/report.h"
#include "haarlight/render/film/film_settings.h"
#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/film/film_file.h"
#include "render/loop/tile_renderer.h"
#include "render/surface/path_integrator.h"
#include "render/surface/photon_integrator.h"

/// @file
/// The integrators of `haarlight render surface`: the options that choose among them, what each
/// takes of these, and how it is made.

namespace haarlight::apps {

enum class IntegratorKind : std::uint8_t {
  ray_casting,
  whitted,
  direct,
  path,
  bidirectional,
  path_naive,
  path_by_area,
  irradiance_cache,
  photon_map,
  radiosity,
  automatic  ///< one of the others: choose_integrator()
};
inline constexpr auto kIntegratorWords = std::to_array<std::string_view>(
    {"ray-casting", "whitted", "direct", "path", "bidirectional", "path-naive", "path-by-area",
     "irradiance-cache", "photon-map", "radiosity", "auto"});
constexpr std::span<const std::string_view> words_of(IntegratorKind) {
  return kIntegratorWords;
}

/// Of --integrator photon-map alone.
struct PhotonArguments {
  std::optional<int> photons;
  std::optional<int> nearest;
  std::optional<render::PhotonKernel> kernel;
  bool has_final_gather = false;
};

struct IntegratorArguments {
  IntegratorKind kind = IntegratorKind::path;
  std::optional<render::LightChoice> given_lights;  ///< on the command line: auto keeps to them
  std::optional<render::DirectSampling> given_sampling;
  render::LightChoice lights = render::PathOptions{}.lights;
  render::DirectSampling sampling = render::DirectSampling::mis;
  render::SamplerKind sampler = render::SamplerKind::sobol;
  std::optional<render::FilterKind> filter;
  std::optional<int> most_bounces;
  std::optional<int> patches;           ///< of radiosity
  std::optional<int> form_factor_rays;  ///< of radiosity
  std::optional<double> accuracy;       ///< of irradiance_cache
  std::optional<int> gather_rays;       ///< of irradiance_cache, of photon_map's final gather
  std::uint64_t seed = 0;
  PhotonArguments photon_map;
};

void add_integrator_options(Command& verb, IntegratorArguments& arguments);

/// Those that were given, where some were, instead of the defaults.
void take_given(IntegratorArguments& arguments);

/// Refuses options that the integrator leaves without a meaning.
void require_integrator_words(const IntegratorArguments& arguments, bool explains);

void report_integrator(const IntegratorArguments& arguments, Report& report);

/// @param has_features  whether the output keeps the layers after the first
[[nodiscard]] render::PathOptions path_options(const IntegratorArguments& arguments,
                                               const render::FilmSettings& film,
                                               const render::Crop& crop, bool has_features);

/// Whether its samples add to other pixels, too: a layer of its film.
[[nodiscard]] bool has_splats(const IntegratorArguments& arguments);

/// What of them a sample's value depends on.
[[nodiscard]] render::RenderSettings integrator_settings(const IntegratorArguments& arguments,
                                                         const render::PathOptions& options);

/// Memory that the integrator takes beside the scene. @throws Error  it cannot render that scene
/// @param path  of the scene, for errors
[[nodiscard]] std::uint64_t integrator_bytes(const IntegratorArguments& arguments,
                                             const render::Scene& scene,
                                             const std::string& path);

/// What an integrator that prepares something before the picture may take for it, and whom it tells.
struct Preparation {
  render::Crop crop;  ///< the part of the picture that the film holds
  std::uint64_t memory_bytes = 0;
  std::function<bool()> is_stopped;  ///< empty: never
  /// Of a bidirectional one: fills SurfaceLayer::path_tracing() for a pilot.
  bool tells_of_path_tracing = false;
  Report* report = nullptr;  ///< nothing: nobody is told
};

[[nodiscard]] std::unique_ptr<render::TileRenderer> make_integrator(
    const IntegratorArguments& arguments, const render::SceneFile& file,
    const render::RayCaster& caster, const render::Environment* environment,
    const render::PathOptions& options, const Preparation& preparation);

}  // namespace haarlight::apps
