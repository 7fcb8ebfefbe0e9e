// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/light/solid_angle.h"

#include <cmath>

#include <Eigen/Geometry>

namespace haarlight::render {

double triangle_solid_angle(const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                            const Eigen::Vector3d& c) {
  // tan(Omega/2) = a.(b x c) / (|a||b||c| + (a.b)|c| + (a.c)|b| + (b.c)|a|)
  const double la = a.norm();
  const double lb = b.norm();
  const double lc = c.norm();
  const double determinant = a.dot((b - a).cross(c - a));
  const double denominator = la * lb * lc + a.dot(b) * lc + a.dot(c) * lb + b.dot(c) * la;
  return 2.0 * std::atan2(determinant, denominator);
}

double solid_angle(std::span<const Eigen::Vector3d> polygon) {
  double sum = 0.0;
  for (std::size_t i = 2; i < polygon.size(); ++i) {
    sum += triangle_solid_angle(polygon[0], polygon[i - 1], polygon[i]);
  }
  return sum;
}

void clip_polygon(const DirectionPolygon& polygon, const Eigen::Vector3d& normal,
                  DirectionPolygon& out) {
  out.clear();
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Eigen::Vector3d& here = polygon[i];
    const Eigen::Vector3d& next = polygon[i + 1 == polygon.size() ? 0 : i + 1];
    const double side_here = normal.dot(here);
    const double side_next = normal.dot(next);
    if (side_here >= 0.0) {
      out.push_back(here);
    }
    if ((side_here > 0.0 && side_next < 0.0) || (side_here < 0.0 && side_next > 0.0)) {
      const double t = side_here / (side_here - side_next);
      out.emplace_back(here + t * (next - here));
    }
  }
}

}  // namespace haarlight::render
