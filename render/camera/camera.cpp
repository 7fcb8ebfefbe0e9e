// SPDX-License-Identifier: Apache-2.0
#include "render/camera/camera.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/rig/picture_area.h"
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
void Camera::clip(Ray& ray) const {
  if (optics_.near_mm > 0.0 || optics_.far_mm > 0.0) {
    const double along = ray.direction.dot(axis());
    ray.t_min = optics_.near_mm > 0.0 ? optics_.near_mm / along : ray.t_min;
    ray.t_max = optics_.far_mm > 0.0 ? optics_.far_mm / along : ray.t_max;
  }
}

Vector3d Camera::lens_point(const Vector2d& lens) const {
  if (!has_lens()) {
    return model_.centre_world();
  }
  const Vector2d at = optics_.lens_radius_mm * concentric_disk(lens);
  return model_.world_from_cam * Vector3d(at.x(), at.y(), 0.0);
}

Ray Camera::ray(double x, double y, const Vector2d& lens) const {
  Ray ray;
  if (optics_.pixel_mm > 0.0) {
    const Vector3d in_camera(optics_.pixel_mm * (x - model_.cx),
                             optics_.pixel_mm * (y - model_.cy), 0.0);
    ray.origin = model_.world_from_cam * in_camera;
    ray.direction = axis();
    clip(ray);
    return ray;
  }
  const CameraRay through = ray_through(model_, x, y);
  ray.origin = through.origin_world;
  ray.direction = through.direction_world;
  if (has_lens()) {
    const double along = through.direction_world.dot(axis());
    const Vector3d in_focus =
        through.origin_world + (optics_.focus_mm / along) * through.direction_world;
    ray.origin = lens_point(lens);
    ray.direction = (in_focus - ray.origin).normalized();
  }
  clip(ray);
  return ray;
}

namespace {

/// Of rounding, and of the Newton steps of ray_through(): not where the model folds back.
constexpr double kSamePoint = 1e-6;  // of the plane at distance 1

}  // namespace

double Camera::pixels_per_sr(const Ray& ray, double x, double y) const {
  if (!can_be_reached()) {
    return 0.0;
  }
  const double along = ray.direction.dot(axis());
  const CameraRay chief = ray_through(model_, x, y);
  const Vector3d in_camera = model_.world_from_cam.linear().transpose() * chief.direction_world;
  if (!model_.distortion.isZero()) {
    const std::optional<Vector2d> back =
        project(model_, chief.origin_world + chief.direction_world);
    const Vector2d off = back ? Vector2d(back->x() - x, back->y() - y) : Vector2d(1.0, 1.0);
    if (!(std::max(std::abs(off.x() / model_.fx), std::abs(off.y() / model_.fy)) <
          kSamePoint)) {
      return 0.0;
    }
  }
  // A unit area of the plane at distance 1 is seen under cos^3.
  return picture_area(model_, in_camera.head<2>() / in_camera.z()) / (along * along * along);
}

std::optional<CameraSight> Camera::sees(const Vector3d& point, const Vector2d& lens) const {
  if (!can_be_reached()) {
    return std::nullopt;
  }
  CameraSight sight;
  const Vector3d origin = lens_point(lens);
  const Vector3d way = point - origin;
  const double depth = way.dot(axis());
  if (!(depth > optics_.near_mm) || (optics_.far_mm > 0.0 && !(depth < optics_.far_mm))) {
    return std::nullopt;
  }
  sight.distance_mm = way.norm();
  sight.ray = {.origin = origin, .direction = way / sight.distance_mm};
  clip(sight.ray);
  sight.ray.t_max = sight.distance_mm;
  const Vector3d in_focus = has_lens() ? Vector3d(origin + (optics_.focus_mm / depth) * way)
                                       : point;  // both on the picture point's chief ray
  const std::optional<Vector2d> at = project(model_, in_focus);
  if (!at) {
    return std::nullopt;
  }
  sight.at = *at;
  if (!model_.distortion.isZero()) {
    const Vector3d chief = ray_through(model_, at->x(), at->y()).direction_world;
    const Vector3d seen = (in_focus - model_.centre_world()).normalized();
    if (!((chief - seen).norm() < kSamePoint)) {
      return std::nullopt;  // the model folds back: that picture point shows another one
    }
  }
  sight.pixels_per_sr = pixels_per_sr(sight.ray, at->x(), at->y());
  if (!(sight.pixels_per_sr > 0.0)) {
    return std::nullopt;
  }
  return sight;
}

}  // namespace haarlight::render
