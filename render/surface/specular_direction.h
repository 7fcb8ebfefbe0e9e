// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "haarlight/render/rays/ray_caster.h"
#include "render/bsdf/bsdf_sample.h"
#include "render/bsdf/shading_frame.h"

/// @file
/// Directions in which a path leaves a surface, in the world.

namespace haarlight::render {

/// Whether a direction is on the side of the triangle on which it is meant to be.
[[nodiscard]] inline bool is_on_its_side(const Hit& hit, const BsdfSample& next,
                                         const Eigen::Vector3d& direction) {
  const double height = hit.flat_normal.dot(direction);
  return next.is_transmission ? height < 0.0 : height > 0.0;
}

/// Mends a direction that an ideal mirror or glass has drawn.
/// @param bsdf          Mirror or Dielectric
/// @param lobe, square  the numbers that it was drawn with
template <class Kind>
void mend_specular(const Kind& bsdf, const Ray& ray, const Hit& hit,
                   const Eigen::Vector3d& to_eye, double lobe, const Eigen::Vector2d& square,
                   BsdfSample& next, Eigen::Vector3d& direction) {
  if (next.to_light == -to_eye) {  // straight through: not rounded by the frame
    direction = ray.direction;
  }
  if (next.is_found && !is_on_its_side(hit, next, direction)) {
    // An interpolated normal that mirrors or refracts to the wrong side of the triangle gives
    // way to the triangle's, so that no light is lost.
    const Eigen::Matrix3d world_from_flat = frame_of(hit.flat_normal);
    next = bsdf.sample(-(world_from_flat.transpose() * ray.direction), lobe, square);
    direction = world_from_flat * next.to_light;
  }
}

}  // namespace haarlight::render
