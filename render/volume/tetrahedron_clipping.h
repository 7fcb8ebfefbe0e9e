// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <vector>

#include <Eigen/Core>

/// @file
/// Tetrahedra cut by planes across the camera's axis, for previews.

namespace haarlight::render {

/// A corner, and what is linear between corners.
struct ClipCorner {
  Eigen::Vector3d camera = Eigen::Vector3d::Zero();  ///< mm, the camera's frame
  double density_value = 0.0;
  double colour_value = 0.0;
  double extinction = 0.0;
  Eigen::Array3d colour = Eigen::Array3d::Zero();
};
using ClipTetrahedron = std::array<ClipCorner, 4>;

/// What of a tetrahedron has low <= z <= high, as up to nine of them.
[[nodiscard]] std::vector<ClipTetrahedron> clip(const ClipTetrahedron& tetrahedron, double low,
                                                double high);

}  // namespace haarlight::render
