// SPDX-License-Identifier: Apache-2.0
#include "render/volume/tetrahedron_clipping.h"

#include <cstddef>

namespace haarlight::render {

namespace {

/// On the edge from a to b, which the plane crosses.
ClipCorner crossing(const ClipCorner& a, const ClipCorner& b, double z) {
  const double s = (z - a.camera.z()) / (b.camera.z() - a.camera.z());
  const auto between = [s](const auto& x, const auto& y) { return (1.0 - s) * x + s * y; };
  ClipCorner corner{.camera = between(a.camera, b.camera),
                    .density_value = between(a.density_value, b.density_value),
                    .colour_value = between(a.colour_value, b.colour_value),
                    .extinction = between(a.extinction, b.extinction),
                    .colour = between(a.colour, b.colour)};
  corner.camera.z() = z;
  return corner;
}

/// A prism of two triangles whose corners stand for each other.
void add_prism(const std::array<ClipCorner, 3>& a, const std::array<ClipCorner, 3>& b,
               std::vector<ClipTetrahedron>& parts) {
  parts.push_back({a[0], a[1], a[2], b[2]});
  parts.push_back({a[0], a[1], b[1], b[2]});
  parts.push_back({a[0], b[0], b[1], b[2]});
}

/// What has sign z >= sign limit.
void add_half(const ClipTetrahedron& tetrahedron, double limit, double sign,
              std::vector<ClipTetrahedron>& parts) {
  ClipTetrahedron sorted;  // first those inside
  std::size_t n_inside = 0;
  for (const bool inside : {true, false}) {
    std::size_t n = inside ? 0 : n_inside;
    for (const ClipCorner& corner : tetrahedron) {
      if ((sign * corner.camera.z() >= sign * limit) == inside) {
        sorted.at(n++) = corner;
      }
    }
    n_inside = inside ? n : n_inside;
  }
  const auto& [a, b, c, d] = sorted;
  switch (n_inside) {
    case 0:
      return;
    case 1:
      parts.push_back({a, crossing(a, b, limit), crossing(a, c, limit), crossing(a, d, limit)});
      return;
    case 2:
      add_prism({a, crossing(a, c, limit), crossing(a, d, limit)},
                {b, crossing(b, c, limit), crossing(b, d, limit)}, parts);
      return;
    case 3:
      add_prism({a, b, c},
                {crossing(a, d, limit), crossing(b, d, limit), crossing(c, d, limit)}, parts);
      return;
    default:
      parts.push_back(tetrahedron);
  }
}

}  // namespace

std::vector<ClipTetrahedron> clip(const ClipTetrahedron& tetrahedron, double low, double high) {
  std::vector<ClipTetrahedron> above;
  add_half(tetrahedron, low, 1.0, above);
  std::vector<ClipTetrahedron> parts;
  for (const ClipTetrahedron& part : above) {
    add_half(part, high, -1.0, parts);
  }
  return parts;
}

}  // namespace haarlight::render
