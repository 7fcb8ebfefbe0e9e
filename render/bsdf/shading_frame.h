// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "haarlight/render/rays/ray_caster.h"

/// @file
/// The frame in which BSDFs are told: z is the normal, on the side that is looked at.

namespace haarlight::render {

/// Columns: two tangents and the unit normal, in the world.
[[nodiscard]] inline Eigen::Matrix3d frame_of(const Eigen::Vector3d& normal) {
  Eigen::Matrix3d world_from_local;
  world_from_local.col(0) = normal.unitOrthogonal();
  world_from_local.col(1) = normal.cross(world_from_local.col(0));
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
