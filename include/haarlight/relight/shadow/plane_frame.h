// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "haarlight/core/rig/rig.h"
#include "haarlight/relight/shadow/projection.h"

/// @file
/// The plane picture: pixel (column i, row j) is the plane point origin + (x0 + (i + 0.5) s) u
/// + (y0 - (j + 0.5) s) v: +x right, +y up, s mm per pixel.

namespace haarlight::relight {

struct PlaneFrame {
  Plane plane;  ///< n of length 1, on the side of `above`
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  Eigen::Vector3d u = Eigen::Vector3d::UnitX();
  Eigen::Vector3d v = Eigen::Vector3d::UnitY();
  double x0_mm = 0.0;  ///< left border
  double y0_mm = 0.0;  ///< upper border
  double texel_mm = 1.0;
  int width = 0;
  int height = 0;

  /// World point of picture coordinates (pixel centres at +0.5, y down).
  [[nodiscard]] Eigen::Vector3d world_of(double column, double row) const;
  /// Picture coordinates of a world point, projected perpendicularly onto the plane.
  [[nodiscard]] Eigen::Vector2d picture_of(const Eigen::Vector3d& world) const;
  /// n.x + d: mm over the plane.
  [[nodiscard]] double height_of(const Eigen::Vector3d& world) const;
};

/// The rig's plane, its picture centred on the plane's origin. n and d are scaled to length 1.
/// @throws ContractViolation  n = 0, or no pixels
[[nodiscard]] PlaneFrame make_plane_frame(const ShadowPlane& plane);

}  // namespace haarlight::relight
