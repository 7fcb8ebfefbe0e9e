// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>

#include <Eigen/Core>

#include "haarlight/render/rays/ray_caster.h"

/// @file
/// The frame in which BSDFs are told: z is the normal, on the side that is looked at.

namespace haarlight::render {

/// Columns: two tangents and the unit normal, in the world [Duff17].
[[nodiscard]] inline Eigen::Matrix3d frame_of(const Eigen::Vector3d& normal) {
  const double sign = std::copysign(1.0, normal.z());
  const double a = -1.0 / (sign + normal.z());
  const double b = normal.x() * normal.y() * a;
  Eigen::Matrix3d world_from_local;
  world_from_local.col(0) << 1.0 + sign * normal.x() * normal.x() * a, sign * b,
      -sign * normal.x();
  world_from_local.col(1) << b, sign + normal.y() * normal.y() * a, -normal.y();
  world_from_local.col(2) = normal;
  return world_from_local;
}

/// Of a hit by a ray of that direction. An interpolated normal that is turned away from the eye
/// gives way to the triangle's.
[[nodiscard]] inline Eigen::Matrix3d shading_frame(const Hit& hit,
                                                   const Eigen::Vector3d& direction) {
  return frame_of(hit.normal.dot(direction) < 0.0 ? hit.normal : hit.flat_normal);
}

}  // namespace haarlight::render
