// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>

#include <Eigen/Core>

#include "render/sampling/warp.h"

/// @file
/// What the BSDFs share: a sampled direction, the cosine law. Conventions: bsdf.h.

namespace haarlight::render {

/// A direction drawn from a BSDF.
struct BsdfSample {
  bool is_found = false;         ///< else the path ends
  bool is_delta = false;         ///< the only direction of its lobe: no other way finds it
  bool is_transmission = false;  ///< `to_light` is on the other side
  Eigen::Vector3d to_light = Eigen::Vector3d::Zero();
  /// f |cos| / density. Of a delta lobe: its reflectance or transmittance over the probability with
  /// which the lobe was chosen.
  Eigen::Vector3d weight = Eigen::Vector3d::Zero();
  double density = 0.0;  ///< per sr; of a delta lobe 0, as it has none
  /// The factor (n_eye/n_light)^2 of `weight`: radiance is larger within a denser medium. It is
  /// undone where the light leaves the medium, so that roulette divides it out.
  double radiance_scale = 1.0;
};

/// Whether both are on the side that is looked at, where an opaque surface scatters.
[[nodiscard]] inline bool are_above(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return a.z() > 0.0 && b.z() > 0.0;
}

/// A direction drawn from cos/pi. @param u, v  in [0, 1)
inline void cosine_direction(double u, double v, double& x, double& y, double& z) {
  cos_sin_of_turns(v, x, y);
  const double sine = std::sqrt(u);
  x *= sine;
  y *= sine;
  z = std::sqrt(std::max(0.0, 1.0 - u));
}

[[nodiscard]] inline Eigen::Vector3d cosine_direction(const Eigen::Vector2d& square) {
  Eigen::Vector3d direction;
  cosine_direction(square.x(), square.y(), direction.x(), direction.y(), direction.z());
  return direction;
}

}  // namespace haarlight::render
