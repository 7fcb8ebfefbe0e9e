// SPDX-License-Identifier: Apache-2.0
#include "render/scene/gltf_light.h"

#include <cmath>
#include <numbers>

#include "render/scene/gltf_values.h"

namespace haarlight::render {

using Eigen::Vector3d;

void add_gltf_light(const JsonValue& json, const Eigen::Affine3d& to_world, Scene& scene) {
  const std::array<double, 3> colour =
      numbers_or<3>(json, "color", {1.0, 1.0, 1.0}, {.min = 0.0, .max = 1e6});
  const double intensity = number_or(json, "intensity", 1.0, {.min = 0.0, .max = 1e18});
  const Vector3d radiometric =
      Vector3d(colour[0], colour[1], colour[2]) * (intensity / kLumensPerWatt);
  // It shines along -z of its node, whatever that one's scale.
  const Vector3d axis = -to_world.linear().col(2).stableNormalized();
  if (!(axis.squaredNorm() > 0.5)) {
    json.refuse("a lamp whose node is scaled to nothing", "give its node another scale");
  }
  const std::size_t kind = json["type"].choice({"directional", "point", "spot"});
  if (kind == 0) {
    scene.directional_lights.push_back({.direction = axis, .irradiance = radiometric});
    return;
  }
  // W/sr over the square of millimetres is a million times that of metres.
  PointLight light{.position = to_world.translation(),
                   .intensity = radiometric * (kMillimetres * kMillimetres),
                   .axis = axis};
  if (kind == 2) {
    const JsonValue spot = json["spot"];
    constexpr double kQuarter = 0.25 * std::numbers::pi;
    const double end = number_or(spot, "outerConeAngle", kQuarter,
                                 {.min = 1e-6, .max = 2.0 * kQuarter + 1e-6});
    const double full = number_or(spot, "innerConeAngle", 0.0, {.min = 0.0, .max = end});
    light.cos_full = std::cos(full);
    light.cos_end = std::cos(end);
  }
  scene.point_lights.push_back(light);
}

}  // namespace haarlight::render
