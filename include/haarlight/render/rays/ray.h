// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <limits>

#include <Eigen/Core>

/// @file
/// Rays and what they hit, before anything is shaded.

namespace haarlight::render {

/// The points origin + t direction with t_min < t < t_max. World frame, mm; the direction may
/// have any length but 0, and t counts in it.
struct Ray {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();
  double t_min = 0.0;
  double t_max = std::numeric_limits<double>::infinity();
};

/// Which surface a ray meets first, if any, and where, in single precision: enough to choose, not to
/// shade. RayCaster::surface_at makes a Hit of it.
struct RawHit {
  static constexpr std::uint32_t kNone = 0xffffffffU;

  float t = std::numeric_limits<float>::infinity();
  float u = 0.0F;  ///< barycentric: the point is (1 - u - v) a + u b + v c
  float v = 0.0F;
  std::uint32_t mesh = kNone;      ///< number of the surface in the scene
  std::uint32_t triangle = kNone;  ///< of the mesh

  [[nodiscard]] bool is_hit() const noexcept { return mesh != kNone; }
};

}  // namespace haarlight::render
