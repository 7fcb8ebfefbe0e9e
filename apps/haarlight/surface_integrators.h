// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
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

/// @file
/// The integrators of `haarlight render surface`: the options that choose among them, what each
/// takes of these, and how it is made.

namespace haarlight::apps {

enum class IntegratorKind : std::uint8_t { ray_casting, whitted, direct, path };
inline constexpr auto kIntegratorWords =
    std::to_array<std::string_view>({"ray-casting", "whitted", "direct", "path"});
constexpr std::span<const std::string_view> words_of(IntegratorKind) {
  return kIntegratorWords;
}

struct IntegratorArguments {
  IntegratorKind kind = IntegratorKind::path;
  render::LightChoice lights = render::PathOptions{}.lights;
  render::DirectSampling sampling = render::DirectSampling::mis;
  render::SamplerKind sampler = render::SamplerKind::sobol;
  std::optional<render::FilterKind> filter;
  std::optional<int> most_bounces;
  std::uint64_t seed = 0;
};

void add_integrator_options(Command& verb, IntegratorArguments& arguments);

/// Refuses options that the integrator leaves without a meaning.
void require_integrator_words(const IntegratorArguments& arguments, bool explains);

void report_integrator(const IntegratorArguments& arguments, Report& report);

/// @param has_features  whether the output keeps the layers after the first
[[nodiscard]] render::PathOptions path_options(const IntegratorArguments& arguments,
                                               const render::FilmSettings& film,
                                               const render::Crop& crop, bool has_features);

/// What of them a sample's value depends on.
[[nodiscard]] render::RenderSettings integrator_settings(const IntegratorArguments& arguments,
                                                         const render::PathOptions& options);

[[nodiscard]] std::unique_ptr<render::TileRenderer> make_integrator(
    const IntegratorArguments& arguments, const render::SceneFile& file,
    const render::RayCaster& caster, const render::Environment* environment,
    const render::PathOptions& options);

}  // namespace haarlight::apps
