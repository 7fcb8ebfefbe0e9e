// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>

#include <Eigen/Core>
#include <Eigen/Geometry>

/// @file
/// Pinhole camera with the Brown-Conrady distortion k1 k2 p1 p2 k3 (OpenCV's model and order).
/// Camera frame: x right, y down, z forward. Pixel centres at +0.5: OpenCV's c_x, c_y are
/// smaller by 0.5. Pure; safe from any thread.

namespace haarlight {

struct CameraModel {
  int width = 0;
  int height = 0;
  double fx = 1.0;  ///< pixels
  double fy = 1.0;
  double cx = 0.0;  ///< pixels, pixel centres at +0.5
  double cy = 0.0;
  Eigen::Matrix<double, 5, 1> distortion = Eigen::Matrix<double, 5, 1>::Zero();
  Eigen::Isometry3d world_from_cam = Eigen::Isometry3d::Identity();

  [[nodiscard]] Eigen::Vector3d centre_world() const { return world_from_cam.translation(); }
};

/// A half-line from the camera, unit direction.
struct CameraRay {
  Eigen::Vector3d origin_world;
  Eigen::Vector3d direction_world;
};

/// The picture point (x right, y down, in pixels) of a world point; nothing when the point is
/// not in front of the camera.
[[nodiscard]] std::optional<Eigen::Vector2d> project(const CameraModel& camera,
                                                     const Eigen::Vector3d& point_world);

/// The ray through a picture point. The distortion is undone by Newton's method to 1e-12 of the
/// focal length; where the model folds back (no solution) the last iterate is used.
[[nodiscard]] CameraRay ray_through(const CameraModel& camera, double x, double y);

/// A camera at `eye` looking at `target`, with the picture's up direction as close to `up` as
/// possible.
[[nodiscard]] Eigen::Isometry3d look_at(const Eigen::Vector3d& eye,
                                        const Eigen::Vector3d& target,
                                        const Eigen::Vector3d& up);

}  // namespace haarlight
