// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>

#include "haarlight/render/rays/ray_caster.h"
#include "render/light/light.h"
#include "render/rays/ray_offset.h"

/// @file
/// The ray from a surface to a point of a light: from where to where it is cast, so that neither
/// hides itself.

namespace haarlight::render {

/// No nearer point of a light is asked: its ray would be shorter than its two offsets, and the first
/// changes what arrives. @param offset, light_offset  mm, of the point and of the light's
[[nodiscard]] inline double nearest_asked(double offset, double light_offset) {
  return 2.0 * offset + light_offset;
}

/// Ends at a point off the light, so that it does not hide itself where it is grazed.
/// @param light_offset  mm, RayCaster::most_offset_mm() of the light's surface; of none 0
[[nodiscard]] inline Ray light_ray(const Hit& hit, const LightSample& light,
                                   double light_offset) {
  const Eigen::Vector3d origin = hit.point + hit.offset_mm * hit.flat_normal;
  if (std::isinf(light.distance_mm)) {
    return {.origin = origin, .direction = light.direction};
  }
  const double off = light_offset + kRounding * kOfWay * light.distance_mm;
  const Eigen::Vector3d target =
      hit.point + light.distance_mm * light.direction + off * light.normal;
  return {.origin = origin, .direction = target - origin, .t_max = 1.0};
}

}  // namespace haarlight::render
