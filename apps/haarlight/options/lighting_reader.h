// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>

#include <fmt/format.h>

#include "core/log.h"
#include "haarlight/capture/plan/plan.h"
#include "haarlight/relight/light/light_weights.h"
#include "haarlight/render/light/cubemap.h"

/// @file
/// The environment of a lighting plan, for load_plan().

namespace haarlight::apps {

/// What each light must give for an environment.
inline capture::Lighting read_lighting(const std::filesystem::path& path, const Rig& rig) {
  const relight::EnvironmentWeights found =
      relight::rig_weights(render::Environment::read(path), rig);
  if (found.missing_fraction > 0.0) {
    log_info(fmt::format("{}: {:.1f} % of its light comes from where the rig has no lights",
                         path.string(), 100.0 * found.missing_fraction));
  }
  return {found.weights, {}};
}

}  // namespace haarlight::apps
