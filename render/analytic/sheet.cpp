// SPDX-License-Identifier: Apache-2.0
#include "render/analytic/sheet.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <Eigen/Geometry>

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

constexpr double kInPlane = 1e-9;  // of the sheet's size: a point that lies in its plane

/// Convex: a rectangle and up to five cuts.
struct Polygon {
  std::array<Vector3d, 9> corners;
  std::size_t n = 0;

  void add(const Vector3d& corner) { corners[n++] = corner; }
};

/// What of a polygon lies where normal.(x - at) >= 0.
Polygon clip(const Polygon& polygon, const Vector3d& at, const Vector3d& normal) {
  Polygon kept;
  for (std::size_t i = 0; i < polygon.n; ++i) {
    const Vector3d& a = polygon.corners[i];
    const Vector3d& b = polygon.corners[(i + 1) % polygon.n];
    const double from = normal.dot(a - at);
    const double to = normal.dot(b - at);
    if (from >= 0.0) {
      kept.add(a);
    }
    if ((from >= 0.0) != (to >= 0.0)) {
      kept.add(a + from / (from - to) * (b - a));
    }
  }
  return kept;
}

double area_of(const Polygon& polygon) {
  Vector3d sum = Vector3d::Zero();
  for (std::size_t i = 2; i < polygon.n; ++i) {
    sum += (polygon.corners[i - 1] - polygon.corners[0])
               .cross(polygon.corners[i] - polygon.corners[0]);
  }
  return 0.5 * sum.norm();
}

}  // namespace

double distance_to(const Sheet& sheet, const Vector3d& origin, const Vector3d& direction) {
  constexpr double kMissed = std::numeric_limits<double>::infinity();
  const Vector3d normal = sheet.side_u.cross(sheet.side_v);
  const double t = normal.dot(sheet.corner - origin) / normal.dot(direction);
  if (!(t > 0.0) || !std::isfinite(t)) {
    return kMissed;
  }
  const Vector3d at = origin + t * direction - sheet.corner;
  const double u = at.dot(sheet.side_u) / sheet.side_u.squaredNorm();
  const double v = at.dot(sheet.side_v) / sheet.side_v.squaredNorm();
  const bool is_met = u >= 0.0 && u <= 1.0 && v >= 0.0 && v <= 1.0;
  if (!is_met) {
    return kMissed;
  }
  return t;
}

double hidden_fraction(const Sheet& sheet, const SquareLight& light, const Vector3d& point) {
  Vector3d normal = sheet.side_u.cross(sheet.side_v).normalized();
  const double over = normal.dot(point - sheet.corner);
  if (std::abs(over) <= kInPlane * (sheet.side_u.norm() + sheet.side_v.norm())) {
    return 0.0;
  }
  normal *= over > 0.0 ? -1.0 : 1.0;  // away from the point
  const Vector3d half_u = 0.5 * light.width_mm * light.u;
  const Vector3d half_v = 0.5 * light.height_mm * light.v;
  Polygon polygon;
  polygon.add(light.centre - half_u - half_v);
  polygon.add(light.centre + half_u - half_v);
  polygon.add(light.centre + half_u + half_v);
  polygon.add(light.centre - half_u + half_v);
  polygon = clip(polygon, sheet.corner, normal);
  const std::array<Vector3d, 4> corners{sheet.corner, sheet.corner + sheet.side_u,
                                        sheet.corner + sheet.side_u + sheet.side_v,
                                        sheet.corner + sheet.side_v};
  const Vector3d middle = 0.5 * (corners[0] + corners[2]) - point;
  for (std::size_t i = 0; i < corners.size() && polygon.n > 0; ++i) {
    Vector3d side = (corners[i] - point).cross(corners[(i + 1) % 4] - point);
    side *= side.dot(middle) > 0.0 ? 1.0 : -1.0;
    polygon = clip(polygon, point, side);
  }
  // A whole light is 1 to the last bit, whatever its corners' rounding.
  const double share = area_of(polygon) / (light.width_mm * light.height_mm);
  return share > 1.0 - 1e-12 ? 1.0 : share;
}

double visible_fraction(std::span<const Sheet> sheets, std::size_t own,
                        const SquareLight& light, const Vector3d& point) {
  double visible = 1.0;
  for (std::size_t i = 0; i < sheets.size(); ++i) {
    visible -= i == own ? 0.0 : hidden_fraction(sheets[i], light, point);
  }
  return std::max(0.0, visible);
}

}  // namespace haarlight::render
