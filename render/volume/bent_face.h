// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "render/volume/cell_faces.h"
#include "render/volume/side_of_ray.h"

/// @file
/// Where rays pass the curved faces of cells with nodes beside their corners.
///
/// The patch through a face's nodes is, in barycentric coordinates l, the Bezier triangle of degree 2 or 3
///
///     x(l) = sum l_i^2 b_i + 2 l_0 l_1 b_01 + 2 l_1 l_2 b_12 + 2 l_2 l_0 b_20,
///     b_i = x_i,  b_ij = 2 x_ij - (x_i + x_j)/2   (x_ij the node on the edge),
///
/// or of four corners, in coordinates (u, v), the biquadratic Bezier patch; one without a node in its middle
/// has the sum of the edges' points less 3/4 of that of the corners there.
///
/// Across the ray it has two coordinates, both 0 where the ray passes. The patch is
/// halved along its edges until the ray surely misses a part (its Bezier points are on one side), or the
/// part is so nearly flat that it has one such point at most, which Newton's method finds.

namespace haarlight::render {

struct VolumeView;

/// A point where a ray passes a bent face.
struct BentCrossing {
  double z = 0.0;
  /// Of the corners as given, barycentric or bilinear; the sum is 1.
  std::array<double, 4> weights{};
  bool is_left_by = false;  ///< of a face anticlockwise seen from outside: it goes out
};

/// Adds all of them, in any order; the same to the bit whichever of its two cells asks.
/// @param p, shift  as RaySides::set_ray()
/// @return  whether these are surely all, and surely there; not so where the ray touches the patch or
///          passes its border to rounding
[[nodiscard]] bool add_bent_crossings(const VolumeView& view, const Eigen::Vector2d& p,
                                      const Eigen::Vector2d& shift, const PatchNodes& nodes,
                                      std::vector<BentCrossing>& crossings);

/// The patch's Bezier points, as the camera sees them, in the order of its nodes; of four corners also the one
/// in the middle.
struct SeenBezier {
  std::array<SeenPoint, 10> points;
  std::size_t n = 0;

  [[nodiscard]] std::span<const SeenPoint> all() const { return std::span(points).first(n); }
};
[[nodiscard]] SeenBezier bezier_of(const VolumeView& view, const PatchNodes& nodes);

}  // namespace haarlight::render
