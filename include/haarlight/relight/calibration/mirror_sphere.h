// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/image.h"
#include "haarlight/core/rig/camera_model.h"

/// @file
/// Lights from mirror spheres, the baseline for near-light calibration: the highlight on a ball
/// gives a direction; the reflected rays of several balls meet at a near light. Pixels with
/// centres at +0.5, y down; directions x right, y up, z to the camera.

namespace haarlight::relight {

struct PictureCircle {
  double x = 0.0;
  double y = 0.0;
  double radius = 0.0;  ///< pixels
  double rms = 0.0;     ///< of the points it was fitted to, pixels
};

/// Where a mask crosses 0.5 of its maximum, between pixel centres: a ball's outline.
/// @param mask  (h, w, any); only the first channel is used
/// @throws Error  nothing, or everything, is inside
[[nodiscard]] std::vector<Eigen::Vector2d> outline_points(ImageView<const float> mask);

/// Least squares (Kasa). @throws Error  fewer than 3 points, or points on a line
[[nodiscard]] PictureCircle fit_circle(std::span<const Eigen::Vector2d> points);

struct HighlightOptions {
  double fraction = 0.8;  ///< of the brightest pixel's value: threshold of the highlight
  double inside = 0.97;   ///< of the radius is searched: the rim mirrors the surroundings
  /// Largest fraction of the ball's area that a highlight may fill.
  double most_area = 0.1;
};

/// Centroid of the brightest connected component, weighted by the excess over the threshold.
/// @param picture  (h, w, 1 or 3); channels are added
/// @throws Error  a black ball; NaN or infinity on it; or no highlight: too large
[[nodiscard]] Eigen::Vector2d find_highlight(ImageView<const float> picture,
                                             const PictureCircle& ball,
                                             const HighlightOptions& options = {});

/// Unit direction to a far light, camera far away: r = 2 (n.v) n - v with v = (0, 0, 1).
/// @throws Error  the highlight lies outside the ball
[[nodiscard]] Eigen::Vector3d mirror_direction(const PictureCircle& ball,
                                               const Eigen::Vector2d& highlight);

// ---- near lights ----

struct MirrorSphere {
  Eigen::Vector3d centre_mm = Eigen::Vector3d::Zero();  ///< world
  double radius_mm = 0.0;
};

/// Where a ball of known radius is, from its outline: the rays through it lie on a cone.
/// @throws Error  fewer than 3 points, or points that are not an outline
[[nodiscard]] MirrorSphere sphere_from_outline(const CameraModel& camera,
                                               std::span<const Eigen::Vector2d> outline,
                                               double radius_mm);

struct ReflectedRay {
  Eigen::Vector3d origin_mm = Eigen::Vector3d::Zero();   ///< on the ball
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  ///< unit, to the light
};
/// @throws Error  the picture point does not show the ball
[[nodiscard]] ReflectedRay reflect_off(const CameraModel& camera, const MirrorSphere& sphere,
                                       const Eigen::Vector2d& highlight);

/// The picture point where a light glints on a ball; for simulation.
[[nodiscard]] Eigen::Vector2d glint_of(const CameraModel& camera, const MirrorSphere& sphere,
                                       const Eigen::Vector3d& light_mm);

struct Triangulated {
  Eigen::Vector3d position_mm = Eigen::Vector3d::Zero();
  double rms_mm = 0.0;  ///< distance of the rays from it
  /// Smallest over largest eigenvalue of sum (1 - d d^T): 0 for parallel rays, along which the
  /// distance is undetermined.
  double conditioning = 0.0;
};
/// The point nearest to all rays, least squares.
/// @throws Error  fewer than two rays, or parallel ones
[[nodiscard]] Triangulated intersect(std::span<const ReflectedRay> rays);

}  // namespace haarlight::relight
