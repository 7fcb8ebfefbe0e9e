// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/plate/planes_plate.h"

#include <algorithm>

namespace haarlight::relight {

PlanesPlate::PlanesPlate(const Rig& rig, int i_camera) {
  for (std::size_t i = 0; i < std::max<std::size_t>(1, rig.planes.size()); ++i) {
    planes_.emplace_back(rig, i_camera, static_cast<int>(i));
    const ShadowPlane& plane = rig.planes[i];
    const Eigen::Vector3d u = plane.extent_u_mm * plane.u;
    const Eigen::Vector3d v = plane.extent_v_mm * plane.v;
    sheets_.push_back({plane.origin - 0.5 * (u + v), u, v});
  }
  camera_ = rig.cameras[static_cast<std::size_t>(i_camera)].model;
}

std::size_t PlanesPlate::plane_at(const CameraRay& ray, double x, double y) const {
  std::size_t nearest = 0;
  double distance = std::numeric_limits<double>::infinity();
  if (const auto view = planes_[0].look(x, y)) {
    distance = (view->point - ray.origin_world).norm();
  }
  for (std::size_t i = 1; i < sheets_.size(); ++i) {
    const double here = render::distance_to(sheets_[i], ray.origin_world, ray.direction_world);
    if (here < distance) {
      distance = here;
      nearest = i;
    }
  }
  return nearest;
}

void PlanesPlate::read_tile(const TileRect& rect, std::span<float> out) const {
  const std::span<const render::SquareLight> lights = planes_[0].lights();
  HAARLIGHT_EXPECTS(out.size() == static_cast<std::size_t>(rect.n_pixels()) * lights.size(),
                    "room for the tile's values");
  std::vector<double> values(lights.size());
  std::size_t at = 0;
  for (int p = 0; p < rect.n_pixels(); ++p) {
    const int row = rect.y0 + p / rect.width;
    const double x = rect.x0 + p % rect.width + 0.5;
    const double y = row + 0.5;
    const std::size_t i = plane_at(ray_through(camera_, x, y), x, y);
    planes_[i].evaluate(x, y, values);
    const auto view = planes_[i].look(x, y);
    for (std::size_t k = 0; k < lights.size(); ++k) {
      const double visible =
          values[k] > 0.0 ? render::visible_fraction(sheets_, i, lights[k], view->point) : 0.0;
      out[at++] = static_cast<float>(visible * values[k]);
    }
  }
}

std::unique_ptr<StackSource> make_rig_plate(const Rig& rig, int i_camera) {
  if (rig.planes.size() > 1) {
    return std::make_unique<PlanesPlate>(rig, i_camera);
  }
  return std::make_unique<ComputedPlate>(rig, i_camera);
}

}  // namespace haarlight::relight
