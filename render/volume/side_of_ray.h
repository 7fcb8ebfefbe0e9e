// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

/// @file
/// On which side of an edge a ray of a camera passes: decided exactly, and never "through it".
///
/// A point of the mesh is (x, y, w) on the picture, w > 0 where it is in front: in perspective its
/// position in the camera's frame, w = z; in parallel projection x, y and w = 1. The ray of picture
/// point (x, y) is p = (x, y, 1), and the side of the edge from a to b is the sign of det[p, a, b].
/// Where that is 0 the picture point is thought to be moved by (e, e^2) for a vanishing e, and where
/// this does not tell either, the eye by far less: simulation of simplicity [Edelsbrunner90]. All
/// rays behave as rays in general position do: each passes into a cell through one face and leaves
/// it through one other, also along edges, in faces and through vertices.

namespace haarlight::render {

/// A point as a camera sees it. Sizes other than 0: 1e-60 to 1e60.
struct SeenPoint {
  double x = 0.0;
  double y = 0.0;
  double z = 0.0;  ///< along the camera's axis
};

/// Whether the points are in perspective; else parallel.
enum class Projection : bool { parallel, perspective };

/// The sign of det[p, a, b] by exact arithmetic, or that of its perturbation: -1 or 1, and the
/// opposite for b and a. About 1 us: for where rounding errors leave it open.
/// @param a, b  two different points
[[nodiscard]] int exact_side(Projection projection, const Eigen::Vector2d& p,
                             const SeenPoint& a, const SeenPoint& b);

/// The sign of det[a, b, c] by exact arithmetic: 1 where a, b and c are clockwise on a picture whose y
/// axis points down, as the camera's does, and anticlockwise where it points up; 0 where they are in
/// one line of the picture. As slow.
[[nodiscard]] int exact_orientation(Projection projection, const SeenPoint& a,
                                    const SeenPoint& b, const SeenPoint& c);

/// The sign of (b - a) x (c - a) . (d - a) by exact arithmetic. As slow.
[[nodiscard]] int exact_side_of_plane(const SeenPoint& a, const SeenPoint& b,
                                      const SeenPoint& c, const SeenPoint& d);

}  // namespace haarlight::render
