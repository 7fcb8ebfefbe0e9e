// SPDX-License-Identifier: Apache-2.0
#include "render/light/mesh_lights.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;

MeshLights::MeshLights(const Scene& scene) {
  double sum = 0.0;
  for (const Mesh& mesh : scene.meshes) {
    const Vector3d& radiance = scene.materials[static_cast<std::size_t>(mesh.material)].emits;
    if (!(radiance.maxCoeff() > 0.0)) {
      first_of_.push_back(-1);
      continue;
    }
    first_of_.push_back(static_cast<int>(emitters_.size()));
    for (const Eigen::Vector3i& triangle : mesh.triangles) {
      const auto corner = [&](int i) -> const Vector3d& {
        return mesh.vertices[static_cast<std::size_t>(triangle[i])];
      };
      const Vector3d a = corner(1) - corner(0);
      const Vector3d b = corner(2) - corner(0);
      const Vector3d across = a.cross(b);
      emitters_.push_back({.corner = corner(0),
                           .side_a = a,
                           .side_b = b,
                           .normal = across.normalized(),
                           .radiance = radiance});
      sum += 0.5 * across.norm() * radiance.mean();
      up_to_.push_back(sum);
    }
  }
  if (!(sum > 0.0)) {  // triangles without area
    emitters_.clear();
    std::fill(first_of_.begin(), first_of_.end(), -1);
    return;
  }
  for (std::size_t i = 0; i < emitters_.size(); ++i) {
    up_to_[i] /= sum;
    emitters_[i].density = emitters_[i].radiance.mean() / sum;
  }
}

LightPoint MeshLights::sample(const Vector2d& square) const {
  HAARLIGHT_EXPECTS(!is_empty(), "a light to draw");
  const auto found = std::upper_bound(up_to_.begin(), up_to_.end(), square.x());
  const auto i =
      std::min(static_cast<std::size_t>(found - up_to_.begin()), emitters_.size() - 1);
  const Emitter& emitter = emitters_[i];
  const double from = i == 0 ? 0.0 : up_to_[i - 1];
  const double within = std::clamp((square.x() - from) / (up_to_[i] - from), 0.0, 1.0);
  // Uniform in a triangle [Osada02].
  const double root = std::sqrt(within);
  return {.emitter = &emitter,
          .point = emitter.corner + root * (1.0 - square.y()) * emitter.side_a +
                   root * square.y() * emitter.side_b};
}

const Emitter* MeshLights::find(std::uint32_t mesh, std::uint32_t triangle) const {
  const int first = first_of_[mesh];
  return first < 0 || emitters_.empty()
             ? nullptr
             : &emitters_[static_cast<std::size_t>(first) + triangle];
}

}  // namespace haarlight::render
