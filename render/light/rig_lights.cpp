// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/light/rig_lights.h"

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::render {

SquareLight square_light(const LightElement& element) {
  SquareLight light;
  light.centre = element.centre;
  light.u = element.u;
  light.v = element.v;
  light.emits = element.emits;
  light.width_mm = element.width_mm;
  light.height_mm = element.height_mm;
  light.lobe_mu = element.lobe_mu;
  return light;
}

std::vector<SquareLight> rig_lights(const Rig& rig) {
  std::vector<SquareLight> lights;
  for (const LightElement& element : light_elements(rig)) {
    lights.push_back(square_light(element));
  }
  return lights;
}

std::vector<int> lights_off_plane(const Rig& rig, const ShadowPlane& plane) {
  const auto height = [&plane](const Eigen::Vector3d& point) {
    return plane.n.dot(point) + plane.d;
  };
  const bool is_seen_from_behind =
      !rig.cameras.empty() &&
      height(rig.cameras.front().model.world_from_cam.translation()) < 0.0;
  const double side = is_seen_from_behind ? -1.0 : 1.0;
  std::vector<int> off;
  for (const LightElement& light : light_elements(rig)) {
    // The LED square's highest corner; the picture's corner farthest in front of the LED.
    const double rise = 0.5 * (light.width_mm * std::abs(plane.n.dot(light.u)) +
                               light.height_mm * std::abs(plane.n.dot(light.v)));
    const double highest = side * height(light.centre) + rise;
    const double in_front = light.emits.dot(plane.origin - light.centre) +
                            0.5 * (plane.extent_u_mm * std::abs(light.emits.dot(plane.u)) +
                                   plane.extent_v_mm * std::abs(light.emits.dot(plane.v)));
    const double rounding = 1e-9 * (light.centre.norm() + std::abs(plane.d));
    if (!(highest > rounding) || !(in_front > rounding)) {
      off.push_back(light.index);
    }
  }
  return off;
}

std::string require_lit_planes(const Rig& rig) {
  std::string warnings;
  for (const ShadowPlane& plane : rig.planes) {
    const std::vector<int> off = lights_off_plane(rig, plane);
    if (off.empty()) {
      continue;
    }
    const auto n_off = static_cast<int>(off.size());
    if (n_off == rig.n_lights()) {
      throw Error(fmt::format("no light reaches the plane \"{}\": all lie in or behind it, or "
                              "shine away from it",
                              plane.id),
                  rig.file.string(),
                  "correct centre and emits of the faces, or n and d of the plane");
    }
    warnings += fmt::format(
        "\n  warning: {} of {} lights (the first: {}) do not reach the plane \"{}\": they lie "
        "in or behind it, or shine away from it\n  hint: nothing, if that is meant; else "
        "correct centre and emits of their face",
        n_off, rig.n_lights(), off.front(), plane.id);
  }
  return warnings;
}

}  // namespace haarlight::render
