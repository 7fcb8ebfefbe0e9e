// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/rig/rig.h"
#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/light/light_weights.h"
#include "haarlight/render/light/cubemap.h"

/// @file
/// What an environment asks of the lights of a basis file.

namespace haarlight::relight {

/// The lights of a capture: a rig's cells, or directions.
class CapturedLights {
 public:
  /// @throws Error  the basis file's rig is no rig
  explicit CapturedLights(const BasisFile& basis);

  /// As rig_weights() or voronoi_weights(). Thread-safe.
  [[nodiscard]] EnvironmentWeights weights(const render::Environment& environment,
                                           double turn_rad = 0.0) const;

 private:
  std::optional<Rig> rig_;
  std::vector<Eigen::Vector3d> directions_;  ///< of a capture without a rig
};

}  // namespace haarlight::relight
