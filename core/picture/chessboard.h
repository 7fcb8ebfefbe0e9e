// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "haarlight/core/image.h"
#include "haarlight/core/rig/camera_model.h"

/// @file
/// A camera's lens and a plane's position from pictures of a printed chessboard. OpenCV behind
/// one .cpp (its own target); pixel centres here at +0.5, OpenCV's at 0
/// (docs/decisions/0002-camera-matrix-pixel-centres.md).

namespace haarlight {

/// A printed board; corners are those where four squares meet.
struct Chessboard {
  int cols =
      9;  ///< inner corners along a row; one odd and one even count distinguishes up from down
  int rows = 6;
  double square_mm = 20.0;
  [[nodiscard]] int n_corners() const { return rows * cols; }
  /// Position of corner i, row by row, mm in the board's own frame (z = 0).
  [[nodiscard]] Eigen::Vector3d corner(int i) const {
    const int row = i / cols;
    return {square_mm * (i - row * cols), square_mm * row, 0.0};
  }
};

/// The inner corners, row by row, in pixels; nothing where no whole board is seen.
/// @param picture  (h, w, 1 or 3), any scale; channels are added
[[nodiscard]] std::optional<std::vector<Eigen::Vector2d>> find_chessboard(
    ImageView<const float> picture, const Chessboard& board);

struct CameraFit {
  CameraModel camera;  ///< pose: left unchanged
  /// Standard deviations of fx, fy, cx, cy, k1, k2, p1, p2, k3; 0: held at 0.
  Eigen::Matrix<double, 9, 1> sigma = Eigen::Matrix<double, 9, 1>::Zero();
  double rms_px = 0.0;
  std::vector<double> view_rms_px;
  std::vector<std::vector<Eigen::Vector2d>> misses_px;  ///< corner found minus corner expected
};
/// Zhang's method and its refinement, as OpenCV has it; k3 is 0 unless requested.
/// @param views  at least 3, with the board tilted differently
/// @throws Error  too few views, a view without every corner, a fit that does not converge
[[nodiscard]] CameraFit fit_camera(std::span<const std::vector<Eigen::Vector2d>> views,
                                   const Chessboard& board, int width, int height,
                                   bool has_k3 = false);

/// A plane n.x + d = 0 in the camera's frame, n towards the camera.
struct PlaneFit {
  Eigen::Vector3d n_cam = -Eigen::Vector3d::UnitZ();
  double d_mm = 0.0;  ///< distance from the camera's centre
  double distance_sigma_mm = 0.0;
  double tilt_sigma_deg = 0.0;  ///< the larger of the two
  double rms_px = 0.0;
  std::vector<Eigen::Vector2d> misses_px;
};
/// @throws Error  not every corner, a board seen edge-on
[[nodiscard]] PlaneFit fit_plane(const CameraModel& camera,
                                 std::span<const Eigen::Vector2d> corners,
                                 const Chessboard& board);

}  // namespace haarlight
