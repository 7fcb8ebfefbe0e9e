// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/rig/camera_model.h"

#include <cmath>

#include "core/rig/picture_area.h"

namespace haarlight {

namespace {

/// Distorts a normalised point: x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2
/// x^2), y' alike with p1, p2 exchanged; and the Jacobian of that map.
Eigen::Vector2d distort(const Eigen::Matrix<double, 5, 1>& k, const Eigen::Vector2d& p,
                        Eigen::Matrix2d* jacobian) {
  const double x = p.x();
  const double y = p.y();
  const double r2 = x * x + y * y;
  const double radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
  if (jacobian != nullptr) {
    const double radial_d = k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[4]);  // d radial / d r^2
    (*jacobian)(0, 0) = radial + 2.0 * x * x * radial_d + 2.0 * k[2] * y + 6.0 * k[3] * x;
    (*jacobian)(0, 1) = 2.0 * x * y * radial_d + 2.0 * k[2] * x + 2.0 * k[3] * y;
    (*jacobian)(1, 0) = (*jacobian)(0, 1);
    (*jacobian)(1, 1) = radial + 2.0 * y * y * radial_d + 6.0 * k[2] * y + 2.0 * k[3] * x;
  }
  return {x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
          y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y};
}

}  // namespace

std::optional<Eigen::Vector2d> project(const CameraModel& camera,
                                       const Eigen::Vector3d& point_world) {
  const Eigen::Vector3d point_cam = camera.world_from_cam.inverse() * point_world;
  if (!(point_cam.z() > 0.0)) {
    return std::nullopt;
  }
  const Eigen::Vector2d p =
      distort(camera.distortion, point_cam.head<2>() / point_cam.z(), nullptr);
  return Eigen::Vector2d(camera.fx * p.x() + camera.cx, camera.fy * p.y() + camera.cy);
}

CameraRay ray_through(const CameraModel& camera, double x, double y) {
  const Eigen::Vector2d wanted((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy);
  Eigen::Vector2d p = wanted;
  if (!camera.distortion.isZero()) {
    constexpr int kMaxSteps = 20;
    constexpr double kStepTol = 1e-14;  // quadratic convergence: the next step is below 1e-28
    for (int i = 0; i < kMaxSteps; ++i) {
      Eigen::Matrix2d jacobian;
      const Eigen::Vector2d residual = distort(camera.distortion, p, &jacobian) - wanted;
      const double determinant = jacobian.determinant();
      if (!(std::abs(determinant) > 1e-12)) {  // the model folds back here
        break;
      }
      const Eigen::Vector2d step = jacobian.inverse() * residual;
      p -= step;
      if (step.squaredNorm() < kStepTol * kStepTol) {
        break;
      }
    }
  }
  const Eigen::Vector3d direction_cam(p.x(), p.y(), 1.0);
  return {camera.centre_world(), (camera.world_from_cam.linear() * direction_cam).normalized()};
}

double picture_area(const CameraModel& camera, const Eigen::Vector2d& on_plane) {
  Eigen::Matrix2d jacobian;
  static_cast<void>(distort(camera.distortion, on_plane, &jacobian));
  return std::abs(camera.fx * camera.fy * jacobian.determinant());
}

Eigen::Isometry3d look_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& target,
                          const Eigen::Vector3d& up) {
  const Eigen::Vector3d forward = (target - eye).normalized();
  const Eigen::Vector3d right = forward.cross(up).normalized();
  Eigen::Isometry3d world_from_cam = Eigen::Isometry3d::Identity();
  world_from_cam.linear().col(0) = right;
  world_from_cam.linear().col(1) = forward.cross(right);
  world_from_cam.linear().col(2) = forward;
  world_from_cam.translation() = eye;
  return world_from_cam;
}

}  // namespace haarlight
