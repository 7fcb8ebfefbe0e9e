// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "render/volume/side_of_ray.h"

/// @file
/// Where rays pass the curved faces of quadratic tetrahedra.
///
/// The patch through a face's six nodes is, in barycentric coordinates l, the quadratic Bezier triangle
///
///     x(l) = sum l_i^2 b_i + 2 l_0 l_1 b_01 + 2 l_1 l_2 b_12 + 2 l_2 l_0 b_20,
///     b_i = x_i,  b_ij = 2 x_ij - (x_i + x_j)/2   (x_ij the node on the edge)
///
/// Across the ray it has two coordinates, both 0 where the ray passes: up to four points. The triangle is
/// halved along its edges until the ray surely misses a part (its Bezier points are on one side), or the
/// part is so nearly flat that it has one such point at most, which Newton's method finds.

namespace haarlight::render {

struct VolumeView;

/// A point where a ray passes a bent face.
struct BentCrossing {
  double z = 0.0;
  std::array<double, 3> weights{};  ///< barycentric, of the corners as given; the sum is 1
  bool is_left_by = false;          ///< of a face anticlockwise seen from outside: it goes out
};

/// Adds all of them, in any order; the same to the bit whichever of its two cells asks.
/// @param p, shift  as RaySides::set_ray()
/// @param nodes  corners, then the middles of 01 12 20
/// @return  whether these are surely all, and surely there; not so where the ray touches the patch or
///          passes its border to rounding
[[nodiscard]] bool add_bent_crossings(const VolumeView& view, const Eigen::Vector2d& p,
                                      const Eigen::Vector2d& shift,
                                      const std::array<std::uint32_t, 6>& nodes,
                                      std::vector<BentCrossing>& crossings);

/// b_0, b_1, b_2, b_01, b_12, b_20 of above, as the camera sees them.
[[nodiscard]] std::array<SeenPoint, 6> bezier_of(const VolumeView& view,
                                                 const std::array<std::uint32_t, 6>& nodes);

}  // namespace haarlight::render
