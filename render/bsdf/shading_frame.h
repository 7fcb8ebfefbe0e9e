// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>

#include <Eigen/Core>

#include "haarlight/render/rays/ray_caster.h"

/// @file
/// The frame in which BSDFs are told: z is the normal, on the side that is looked at.

namespace haarlight::render {

/// Two tangents of a unit normal (x, y, z), without a branch [Duff17].
inline void tangents_of(double x, double y, double z, double (&first)[3], double (&second)[3]) {
  const double sign = std::copysign(1.0, z);
  const double a = -1.0 / (sign + z);
  const double b = x * y * a;
  first[0] = 1.0 + sign * x * x * a;
  first[1] = sign * b;
  first[2] = -sign * x;
  second[0] = b;
  second[1] = sign + y * y * a;
  second[2] = -y;
}

/// Columns: two tangents and the unit normal, in the world.
[[nodiscard]] inline Eigen::Matrix3d frame_of(const Eigen::Vector3d& normal) {
  double first[3];
  double second[3];
  tangents_of(normal.x(), normal.y(), normal.z(), first, second);
  Eigen::Matrix3d world_from_local;
  world_from_local.col(0) << first[0], first[1], first[2];
  world_from_local.col(1) << second[0], second[1], second[2];
  world_from_local.col(2) = normal;
  return world_from_local;
}

/// Of a hit by a ray of that direction. An interpolated normal that is turned away from the eye
/// gives way to the triangle's.
[[nodiscard]] inline const Eigen::Vector3d& shading_normal(const Hit& hit,
                                                           const Eigen::Vector3d& direction) {
  return hit.normal.dot(direction) < 0.0 ? hit.normal : hit.flat_normal;
}
[[nodiscard]] inline Eigen::Matrix3d shading_frame(const Hit& hit,
                                                   const Eigen::Vector3d& direction) {
  return frame_of(shading_normal(hit, direction));
}

}  // namespace haarlight::render
