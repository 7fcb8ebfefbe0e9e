// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/circle_polygon.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;

/// a_x b_y - a_y b_x within two roundings, by Kahan's algorithm [Jeannerod13]: an edge of vertices
/// far away may pass close by the centre.
double cross(const Vector2d& a, const Vector2d& b) {
  const double product = a.y() * b.x();
  const double error = std::fma(-a.y(), b.x(), product);
  return std::fma(a.x(), b.y(), -product) + error;
}

/// What the triangle of the centre and an edge has in common with the disk, as signed area.
struct EdgePart {
  double triangle = 0.0;   ///< twice the area over the edge's part inside the circle
  double angle = 0.0;      ///< of the sectors: twice their area
  bool is_inside = false;  ///< a part of the edge is inside the circle
};

/// On the edge's line, points are h n + k d, h the signed distance of the line from the centre; d
/// the edge's direction. The line is inside the circle for |k| < sqrt(1 - h^2).
EdgePart part_of(const Vector2d& a, const Vector2d& b) {
  const Vector2d edge = b - a;
  const double length = edge.norm();
  if (length == 0.0) {
    return {};
  }
  const Vector2d d = edge / length;
  const double h = cross(a, b) / length;
  const double from = a.dot(d);
  const double to = b.dot(d);
  const auto angle_between = [h](double k0, double k1) {
    return std::atan2(h * (k1 - k0), h * h + k0 * k1);
  };
  const double half_chord = std::abs(h) < 1.0 ? std::sqrt((1.0 - h) * (1.0 + h)) : 0.0;
  const double enters = std::max(from, -half_chord);
  const double leaves = std::min(to, half_chord);
  if (!(enters < leaves)) {
    return {.angle = angle_between(from, to)};
  }
  EdgePart part{.triangle = h * (leaves - enters), .is_inside = true};
  part.angle += from < enters ? angle_between(from, enters) : 0.0;
  part.angle += to > leaves ? angle_between(leaves, to) : 0.0;
  return part;
}

}  // namespace

double unit_disk_intersection(std::span<const Vector2d> polygon) {
  double triangles = 0.0;
  double angles = 0.0;
  bool is_inside = false;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    HAARLIGHT_EXPECTS(polygon[i].allFinite(), "finite vertices");
    const EdgePart part = part_of(polygon[i], polygon[(i + 1) % polygon.size()]);
    triangles += part.triangle;
    angles += part.angle;
    is_inside = is_inside || part.is_inside;
  }
  if (!is_inside) {  // the angles are whole turns about the centre
    angles = 2.0 * std::numbers::pi * std::round(angles / (2.0 * std::numbers::pi));
  }
  return std::clamp(0.5 * std::abs(triangles + angles), 0.0, std::numbers::pi);
}

}  // namespace haarlight::render
