// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include <Eigen/Core>

/// @file
/// What a polygon and a disk have in common, in closed form: along each edge, a triangle where the
/// edge is inside the circle, a sector of the disk where it is outside.

namespace haarlight::render {

/// Area of the intersection of the unit disk and a polygon, 0..pi. Absolute error: a few
/// roundings of pi for each vertex; exact where no edge meets the circle and no vertex is in it.
/// Edges that go to the centre, touch the circle or have no length are allowed. Pure.
/// @param polygon  simple, of either orientation; fewer than three vertices have no area
/// @throws ContractViolation  a vertex is not finite
[[nodiscard]] double unit_disk_intersection(std::span<const Eigen::Vector2d> polygon);

}  // namespace haarlight::render
