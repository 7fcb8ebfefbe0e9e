// SPDX-License-Identifier: Apache-2.0
#include "tests/render/soft_shadow/convex_truth.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <utility>

#include "haarlight/core/error.h"
#include "render/soft_shadow/circle_polygon.h"

namespace haarlight::test {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr std::size_t kMostPieces = 4;

double cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

/// What of a convex polygon has a height >= 0, the height linear in the vertex [Sutherland74].
template <class Vertex, class Height>
std::vector<Vertex> clip(const std::vector<Vertex>& polygon, const Height& height) {
  std::vector<Vertex> kept;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Vertex& a = polygon[i];
    const Vertex& b = polygon[(i + 1) % polygon.size()];
    const double at_a = height(a);
    const double at_b = height(b);
    if (at_a >= 0.0) {
      kept.push_back(a);
    }
    if ((at_a > 0.0 && at_b < 0.0) || (at_a < 0.0 && at_b > 0.0)) {
      kept.push_back(Vertex((a * at_b - b * at_a) / (at_b - at_a)));
    }
  }
  return kept;
}

/// Counter-clockwise (Andrew's monotone chain).
Polygon2 convex_hull(Polygon2 points) {
  std::sort(points.begin(), points.end(), [](const Vector2d& a, const Vector2d& b) {
    return std::pair(a.x(), a.y()) < std::pair(b.x(), b.y());
  });
  points.erase(std::unique(points.begin(), points.end()), points.end());
  if (points.size() < 3) {
    return {};
  }
  Polygon2 hull;
  const auto add_chain = [&hull](auto begin, auto end) {
    const std::size_t first = hull.size();
    for (auto p = begin; p != end; ++p) {
      while (hull.size() >= first + 2 && cross(hull[hull.size() - 1] - hull[hull.size() - 2],
                                               *p - hull[hull.size() - 1]) <= 0.0) {
        hull.pop_back();
      }
      hull.push_back(*p);
    }
    hull.pop_back();  // the other chain's first
  };
  add_chain(points.begin(), points.end());
  add_chain(points.rbegin(), points.rend());
  return hull.size() < 3 ? Polygon2{} : hull;
}

/// Area of the union of convex polygons: sum over their subsets of (-1)^(n - 1) times the measure
/// of the subset's intersection.
double area_of_union(std::span<const Polygon2> polygons,
                     const std::function<double(const Polygon2&)>& measure) {
  double sum = 0.0;
  for (unsigned subset = 1; subset < 1U << polygons.size(); ++subset) {
    Polygon2 common;
    int n = 0;
    for (std::size_t i = 0; i < polygons.size(); ++i) {
      if ((subset >> i & 1U) != 0) {
        common = n == 0 ? polygons[i] : intersection(common, polygons[i]);
        ++n;
      }
    }
    sum += (n % 2 == 1 ? 1.0 : -1.0) * measure(common);
  }
  return sum;
}

std::vector<Polygon2> shadows_of(std::span<const ConvexPiece> pieces, const Vector3d& x,
                                 double half_side) {
  HAARLIGHT_EXPECTS(pieces.size() <= kMostPieces, "at most four pieces");
  std::vector<Polygon2> shadows;
  for (const ConvexPiece& piece : pieces) {
    shadows.push_back(shadow_on_light(piece, x, half_side));
  }
  return shadows;
}

}  // namespace

ConvexPiece convex_piece_of(const render::Mesh& mesh) {
  ConvexPiece piece;
  for (const Eigen::Vector3i& triangle : mesh.triangles) {
    std::vector<Vector3d> face;
    for (const int corner : triangle) {
      face.push_back(mesh.vertices[static_cast<std::size_t>(corner)]);
    }
    piece.push_back(std::move(face));
  }
  return piece;
}

/// The line from x through v meets z = 0 in (X, Y)/W with
///
///     (X, Y) = (v_x, v_y) x_z - (x_x, x_y) v_z,   W = x_z - v_z,
///
/// and v is between x and that point for 0 <= v_z < x_z, that is 0 < W <= x_z. Clipping by
/// |X|, |Y| <= half_side W leaves no W < 0, and no point of W = 0 but (0, 0, 0): the receiver.
Polygon2 shadow_on_light(const ConvexPiece& piece, const Vector3d& x, double half_side) {
  HAARLIGHT_EXPECTS(x.allFinite() && x.z() > 0.0, "a receiver in front of the light");
  Polygon2 points;
  for (const std::vector<Vector3d>& face : piece) {
    std::vector<Vector3d> cast;
    for (const Vector3d& v : face) {
      HAARLIGHT_EXPECTS(v.allFinite(), "finite vertices");
      const Vector2d in_plane = v.head<2>() * x.z() - x.head<2>() * v.z();
      cast.emplace_back(in_plane.x(), in_plane.y(), x.z() - v.z());
    }
    cast = clip(cast, [&](const Vector3d& p) { return x.z() - p.z(); });
    for (const int axis : {0, 1}) {
      cast = clip(cast, [&](const Vector3d& p) { return half_side * p.z() - p[axis]; });
      cast = clip(cast, [&](const Vector3d& p) { return half_side * p.z() + p[axis]; });
    }
    for (const Vector3d& p : cast) {
      if (p.z() > 0.0) {
        points.emplace_back(p.head<2>() / p.z());
      }
    }
  }
  return convex_hull(std::move(points));
}

Polygon2 intersection(const Polygon2& polygon, const Polygon2& window) {
  if (window.size() < 3) {
    return {};
  }
  Polygon2 kept = polygon;
  for (std::size_t i = 0; i < window.size(); ++i) {
    const Vector2d& from = window[i];
    const Vector2d along = window[(i + 1) % window.size()] - from;
    kept = clip(kept, [&](const Vector2d& p) { return cross(along, p - from); });
  }
  return kept;
}

double area_of(const Polygon2& polygon) {
  double sum = 0.0;
  for (std::size_t i = 2; i < polygon.size(); ++i) {
    sum += cross(polygon[i - 1] - polygon[0], polygon[i] - polygon[0]);
  }
  return 0.5 * sum;
}

double true_disk_visibility(std::span<const ConvexPiece> pieces, const Vector3d& x,
                            double radius) {
  HAARLIGHT_EXPECTS(radius > 0.0 && std::isfinite(radius), "a radius above 0");
  if (!(x.z() > 0.0)) {
    return 0.0;
  }
  const double hidden =
      area_of_union(shadows_of(pieces, x, 1.25 * radius), [radius](Polygon2 polygon) {
        for (Vector2d& p : polygon) {
          p /= radius;
        }
        return render::unit_disk_intersection(polygon);
      });
  return std::clamp(1.0 - hidden / std::numbers::pi, 0.0, 1.0);
}

double true_polygon_visibility(std::span<const ConvexPiece> pieces, const Vector3d& x,
                               const Polygon2& light) {
  const double area = area_of(light);
  HAARLIGHT_EXPECTS(area > 0.0 && std::isfinite(area),
                    "a light of some area, counter-clockwise");
  if (!(x.z() > 0.0)) {
    return 0.0;
  }
  double farthest = 0.0;
  for (const Vector2d& p : light) {
    farthest = std::max(farthest, p.cwiseAbs().maxCoeff());
  }
  const double hidden =
      area_of_union(shadows_of(pieces, x, 1.25 * farthest),
                    [&](const Polygon2& p) { return area_of(intersection(p, light)); });
  return std::clamp(1.0 - hidden / area, 0.0, 1.0);
}

}  // namespace haarlight::test
