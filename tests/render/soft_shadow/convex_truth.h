// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/mesh/triangle_mesh.h"

/// @file
/// The visible fraction of a light behind convex pieces in closed form, for tests: the pieces'
/// shadows on the light's plane, cast by the receiver as if it were a light. It uses no
/// silhouettes, volumes or distances of the method that it is the truth for. Light frame: the
/// light lies in the plane z = 0 and emits to +z; a receiver at z <= 0 sees nothing of it. What of
/// a piece is at z < 0 hides nothing. Absolute error: about 1e-14 for a handful of faces, more for
/// a receiver that nearly touches a piece.

namespace haarlight::test {

/// A closed convex body by its faces, or a flat convex sheet by one: each face a convex polygon of
/// either orientation.
using ConvexPiece = std::vector<std::vector<Eigen::Vector3d>>;

/// @param mesh  convex, closed or flat
[[nodiscard]] ConvexPiece convex_piece_of(const render::Mesh& mesh);

using Polygon2 = std::vector<Eigen::Vector2d>;

/// The convex polygon of the points of the plane z = 0 that a piece hides from x, counter-
/// clockwise, as far as they lie in the square |x|, |y| <= half_side; empty: none.
/// @param x  x.z > 0
[[nodiscard]] Polygon2 shadow_on_light(const ConvexPiece& piece, const Eigen::Vector3d& x,
                                       double half_side);

/// What two convex polygons have in common, both counter-clockwise.
[[nodiscard]] Polygon2 intersection(const Polygon2& polygon, const Polygon2& window);

/// Signed: positive if counter-clockwise.
[[nodiscard]] double area_of(const Polygon2& polygon);

/// V of a disk of that radius about the origin, behind all pieces together, at most four: the
/// union of their shadows by inclusion and exclusion.
/// @throws ContractViolation  more pieces, a radius not above 0
[[nodiscard]] double true_disk_visibility(std::span<const ConvexPiece> pieces,
                                          const Eigen::Vector3d& x, double radius);

/// V of a light that is a convex polygon, counter-clockwise.
/// @throws ContractViolation  more than four pieces, a polygon without area or clockwise
[[nodiscard]] double true_polygon_visibility(std::span<const ConvexPiece> pieces,
                                             const Eigen::Vector3d& x, const Polygon2& light);

}  // namespace haarlight::test
