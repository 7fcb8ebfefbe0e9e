// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "render/volume/volume_view.h"

/// @file
/// Cells as convex bodies, which can be cut, and which of two hides a part of the other.

namespace haarlight::render {

/// Half a space, in the camera's frame.
struct HalfSpace {
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  ///< unit, out of it
  double offset = 0.0;                               ///< normal.x <= offset within
};

/// A convex polyhedron, in the camera's frame.
struct ConvexBody {
  /// But for those that cuts made: their edges are in the others.
  std::vector<std::vector<Eigen::Vector3d>> faces;
  std::vector<HalfSpace> planes;      ///< of all its faces
  std::vector<Eigen::Vector2d> hull;  ///< on the picture, as (x, y) of side_of_ray.h
};

/// What the cell has within the picture, in front of the eye and between the clipping planes; without
/// faces: nothing.
[[nodiscard]] ConvexBody body_of(const VolumeView& view, std::uint32_t cell);

/// Its parts within half a space and beyond it, if there is something on either side: more than 1e-9 of
/// the mesh's size.
[[nodiscard]] std::optional<std::array<ConvexBody, 2>> cut(const VolumeView& view,
                                                           const ConvexBody& body,
                                                           const HalfSpace& half);

/// Whether a is before b where they share more of the picture than a line or a point, to 1e-9, and more
/// than 1e-10 of the smaller of their own. Of bodies that
/// do not overlap one is before the other there, everywhere.
[[nodiscard]] bool hides(const VolumeView& view, const ConvexBody& a, const ConvexBody& b);

}  // namespace haarlight::render
