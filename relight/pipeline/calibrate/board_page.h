// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/rig/camera_model.h"

/// @file
/// A page with every corner of a chessboard's pictures and its residual in a fit.

namespace haarlight::relight {

/// A picture in which the whole board was found.
struct SeenBoard {
  std::string picture;
  std::vector<Eigen::Vector2d> corners;  ///< pixels
};

/// @param summary  plain text, above the figures
/// @param misses   of each picture's corners, pixels
[[nodiscard]] std::string board_page(const std::string& title, const std::string& summary,
                                     const CameraModel& camera,
                                     const std::vector<SeenBoard>& seen,
                                     const std::vector<std::vector<Eigen::Vector2d>>& misses);

}  // namespace haarlight::relight
