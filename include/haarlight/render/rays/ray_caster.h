// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/scene/scene.h"

/// @file
/// Rays against a scene's triangles, by Embree. Thread-safe after construction.

namespace haarlight::render {

struct Hit {
  double distance_mm = 0.0;
  Eigen::Vector3d point;        ///< world
  Eigen::Vector3d normal;       ///< shading normal, unit, turned towards the ray's origin
  Eigen::Vector3d flat_normal;  ///< of the triangle, unit, turned towards the ray's origin
  int mesh = 0;
  int triangle = 0;
  int material = 0;
};

class RayCaster {
 public:
  explicit RayCaster(const Scene& scene);
  ~RayCaster();
  RayCaster(RayCaster&&) noexcept;
  RayCaster& operator=(RayCaster&&) noexcept;
  RayCaster(const RayCaster&) = delete;
  RayCaster& operator=(const RayCaster&) = delete;

  /// The nearest hit beyond `min_distance_mm`. @param direction  unit
  [[nodiscard]] std::optional<Hit> intersect(const Eigen::Vector3d& origin,
                                             const Eigen::Vector3d& direction,
                                             double min_distance_mm = 0.0) const;

  /// How far off a surface a ray must start to miss it despite Embree's rounding: 2^-18 (4e-6)
  /// of the scene's radius about the middle of its bounding box, so that results do not depend
  /// on a scene's size or position. No smaller detail casts a shadow.
  [[nodiscard]] double ray_offset_mm() const noexcept;

  /// The scene's.
  [[nodiscard]] const std::vector<Mesh>& meshes() const noexcept;

  /// Whether anything lies strictly between a point and each of many, shortened by
  /// ray_offset_mm() at each end. @param blocked  (to.size(),), 1 or 0
  void are_blocked(const Eigen::Vector3d& from, std::span<const Eigen::Vector3d> to,
                   std::span<std::uint8_t> blocked) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace haarlight::render
