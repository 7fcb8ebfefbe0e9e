// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "apps/haarlight/surface_integrators.h"
#include "core/report.h"
#include "haarlight/render/film/film_settings.h"
#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/loop/pilot.h"
#include "render/loop/tile_renderer.h"

/// @file
/// `haarlight render surface --integrator auto`: the integrator, which lights are asked and how
/// light is found, by a pilot; and what it tells of its reasons.

namespace haarlight::apps {

/// What auto chooses for.
struct AutoRequest {
  IntegratorArguments integrator;
  std::optional<double> max_error;
  std::optional<double> seconds;
  std::string film;  ///< of --film; empty: none
  bool has_features = false;
  std::uint64_t memory_bytes = 0;  ///< that the film may take, twice
};

struct AutoChoice {
  IntegratorArguments integrator;  ///< as if it had been named
  std::optional<render::PilotPrediction> for_error;
  std::optional<double> error_in_time;
  double seconds = 0.0;  ///< that the pilot took
};

/// Refuses options that leave auto without a target, or its choice without a meaning.
void require_auto_words(const AutoRequest& request, bool is_part, bool explains);

/// Goes on as a film was begun, where there is one; else by a pilot. Prints why.
/// @throws Error  the film was begun by what auto cannot choose for this scene
[[nodiscard]] AutoChoice choose_integrator(const AutoRequest& request,
                                           const render::SceneFile& file,
                                           const render::RayCaster& caster,
                                           const render::Environment* environment,
                                           const render::Crop& crop, Report& report);

/// Prints what was predicted beside what came of it.
void tell_outcome(const AutoRequest& request, const AutoChoice& choice,
                  const render::RunResult& result, Report& report);

}  // namespace haarlight::apps
