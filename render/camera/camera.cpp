// SPDX-License-Identifier: Apache-2.0
#include "render/camera/camera.h"

#include <utility>

#include "haarlight/core/error.h"
#include "render/sampling/warp.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;

Camera::Camera(CameraModel model, const CameraOptics& optics)
    : model_(std::move(model)), optics_(optics) {
  HAARLIGHT_EXPECTS(
      !(optics.lens_radius_mm > 0.0) || (optics.focus_mm > 0.0 && !(optics.pixel_mm > 0.0)),
      "a lens is in focus somewhere, and not orthographic");
  HAARLIGHT_EXPECTS(optics.near_mm >= 0.0 && optics.far_mm >= 0.0 &&
                        (optics.far_mm == 0.0 || optics.near_mm < optics.far_mm),
                    "something is between near and far");
}

/// All rays start on the plane through the camera across its axis.
Ray Camera::clipped(Ray ray) const {
  const double along = ray.direction.dot(axis());
  if (optics_.near_mm > 0.0) {
    ray.t_min = optics_.near_mm / along;
  }
  if (optics_.far_mm > 0.0) {
    ray.t_max = optics_.far_mm / along;
  }
  return ray;
}

Ray Camera::ray(double x, double y, const Vector2d& lens) const {
  if (optics_.pixel_mm > 0.0) {
    const Vector3d in_camera(optics_.pixel_mm * (x - model_.cx),
                             optics_.pixel_mm * (y - model_.cy), 0.0);
    return clipped({.origin = model_.world_from_cam * in_camera, .direction = axis()});
  }
  const CameraRay through = ray_through(model_, x, y);
  if (!has_lens()) {
    return clipped({.origin = through.origin_world, .direction = through.direction_world});
  }
  const double along = through.direction_world.dot(axis());
  const Vector3d in_focus =
      through.origin_world + (optics_.focus_mm / along) * through.direction_world;
  const Vector2d at = optics_.lens_radius_mm * concentric_disk(lens);
  const Vector3d origin = model_.world_from_cam * Vector3d(at.x(), at.y(), 0.0);
  return clipped({.origin = origin, .direction = (in_focus - origin).normalized()});
}

}  // namespace haarlight::render
