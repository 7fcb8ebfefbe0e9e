// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>

#include "render/volume/volume_view.h"

/// @file
/// A face that a ray passes, and where.

namespace haarlight::render {

/// A point of the mesh as seen from one ray: (x, y) of det[p, a, b] = a.x b.y - a.y b.x, and by how
/// much these may be off.
struct Corner {
  std::uint32_t node = 0;
  const FieldPoint* point = nullptr;
  double x = 0.0;
  double y = 0.0;
  double error = 0.0;
  double size = 0.0;  ///< |x| + |y|
};

/// A point of a ray, and the fields there.
struct Crossing {
  double z = 0.0;
  double density = 0.0;
  double colour = 0.0;
  double contour = 0.0;
};
[[nodiscard]] Crossing between(const Crossing& from, const Crossing& to, double s);

/// A ray in a face's plane, to rounding, is in it from one edge to another; and a ray nearly so may
/// pass it within a range that rounding leaves open.
enum class Passing : std::uint8_t { any, earliest, latest };

/// Anticlockwise as the ray sees it: all edges have it on their positive side (side_of_ray.h).
struct PassedFace {
  std::array<Corner, 3> corners;
  /// det[p, corner i, corner i + 1], >= 0.
  std::array<double, 3> sides{};

  /// Of the corners, for the point where the ray passes: on the face, and beside the ray by no more
  /// than its corners may be. The same for both cells that share the face.
  [[nodiscard]] std::array<double, 3> weights(Passing passing = Passing::any) const;
  [[nodiscard]] Crossing crossing(Passing passing = Passing::any) const;

 private:
  [[nodiscard]] std::array<double, 3> weights_edge_on(Passing passing) const;
};

}  // namespace haarlight::render
