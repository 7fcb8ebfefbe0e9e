// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/scene/scene.h"

/// @file
/// The triangles of a scene that emit light, drawn by their power. A triangle emits from its
/// front (the side from which its corners go counter-clockwise), the same radiance in all
/// directions.

namespace haarlight::render {

/// A triangle of a light.
struct Emitter {
  Eigen::Vector3d corner;
  Eigen::Vector3d side_a;
  Eigen::Vector3d side_b;
  Eigen::Vector3d normal;  ///< unit, of the side that emits
  Eigen::Vector3d radiance;
  double density = 0.0;  ///< per mm^2, with which a point of it is drawn
};

struct LightPoint {
  const Emitter* emitter;
  Eigen::Vector3d point;
};

class MeshLights {
 public:
  explicit MeshLights(const Scene& scene);

  [[nodiscard]] bool is_empty() const noexcept { return emitters_.empty(); }

  /// The square's first side is cut by power, a part for each triangle, so that points which
  /// are even in the square are even on the lights.
  /// @param square  in [0, 1)^2. There must be a light.
  [[nodiscard]] LightPoint sample(const Eigen::Vector2d& square) const;

  /// That triangle of the scene, where it emits.
  [[nodiscard]] const Emitter* find(std::uint32_t mesh, std::uint32_t triangle) const;

 private:
  std::vector<Emitter> emitters_;  ///< all triangles of meshes that emit
  std::vector<double> up_to_;      ///< of each: the fraction of the power up to and with it
  std::vector<int> first_of_;      ///< by mesh: its first, or -1
};

}  // namespace haarlight::render
