// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/light/square_light.h"

/// @file
/// Regular arrays among a list of lights.

namespace haarlight::render {

/// A regular block of lights within a list: light first + row * cols + col.
struct LightGrid {
  int first = 0;
  int rows = 1;
  int cols = 1;
  Eigen::Vector3d step_u = Eigen::Vector3d::Zero();  ///< centre to centre along a row
  Eigen::Vector3d step_v = Eigen::Vector3d::Zero();  ///< from row to row
};

/// Finds the largest regular blocks in list order; a light on its own is a 1 x 1 block.
[[nodiscard]] std::vector<LightGrid> find_light_grids(std::span<const SquareLight> lights);

}  // namespace haarlight::render
