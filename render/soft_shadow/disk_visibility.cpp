// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/disk_visibility.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"
#include "render/soft_shadow/circular_segment.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

/// x_s (x - x_v) / (2 x_v (x - x_s)): the part of the diameter between the edge's line and the end
/// by which the boundary x_v was found.
double part_of_diameter(double x, double x_s, double x_v) {
  const double scale = std::isinf(x_s) ? -1.0 : x_s / (x - x_s);
  return scale * (x - x_v) / (2.0 * x_v);
}

void check_distances(double x, double x_s, double x_v) {
  HAARLIGHT_EXPECTS(x > 0.0 && std::isfinite(x), "a receiver in front of the light");
  HAARLIGHT_EXPECTS(!std::isnan(x_s), "a distance of the edge's plane");
  HAARLIGHT_EXPECTS(x_v > 0.0, "a distance of the shadow volume above 0");
}

}  // namespace

double disk_visibility(double t, VisibilityForm form) {
  HAARLIGHT_EXPECTS(t >= 0.0 && t <= 1.0, "a fraction of the diameter, 0..1");
  switch (form) {
    case VisibilityForm::exact:
      return segment_fraction_of_height(t);
    case VisibilityForm::cubic:
      return t * t * (3.0 - 2.0 * t);
    case VisibilityForm::linear:
      return t;
  }
  HAARLIGHT_EXPECTS(false, "a form of the visibility");
  return 0.0;
}

double t_from_umbra(double x, double x_s, double x_uv) {
  check_distances(x, x_s, x_uv);
  return x <= x_uv ? 0.0 : part_of_diameter(x, x_s, x_uv);
}

double t_from_penumbra(double x, double x_s, double x_pv) {
  check_distances(x, x_s, x_pv);
  return x <= x_pv ? 1.0 : 1.0 - part_of_diameter(x, x_s, x_pv);
}

/// With k = r/A and y = 1 - 2t: s = y/w, w^2 = 1 - 4 k^2 t (1 - t), and from
/// w^2 - y^2 = 4 t (1 - t) (1 - k^2), for y >= 0,
///
///     (1 - s)/2 = 2 t (1 - t) (1 - k^2) / (w (w + y)).
double t_of_tilted_edge(double t, double r_over_a) {
  HAARLIGHT_EXPECTS(t >= 0.0 && t <= 1.0, "a fraction of the diameter, 0..1");
  HAARLIGHT_EXPECTS(r_over_a >= 0.0 && r_over_a <= 1.0, "an edge whose line misses the disk");
  if (t > 0.5) {
    return 1.0 - t_of_tilted_edge(1.0 - t, r_over_a);
  }
  const double y = 1.0 - 2.0 * t;
  const double product = t * (1.0 - t);
  const double w = std::sqrt(1.0 - 4.0 * r_over_a * r_over_a * product);
  if (w == 0.0) {
    return 0.5;  // k = 1, t = 1/2: the line through c, by symmetry
  }
  return 2.0 * product * (1.0 - r_over_a) * (1.0 + r_over_a) / (w * (w + y));
}

std::optional<DiskLine> line_on_disk(const Vector3d& x, const Vector3d& v1, const Vector3d& v2,
                                     double radius) {
  HAARLIGHT_EXPECTS(x.allFinite() && v1.allFinite() && v2.allFinite(), "finite positions");
  HAARLIGHT_EXPECTS(x.z() > 0.0, "a receiver in front of the light");
  HAARLIGHT_EXPECTS(radius > 0.0 && std::isfinite(radius), "a radius above 0");
  const Vector3d way = v1 - x;
  const Vector3d edge = v2 - v1;
  const Vector3d normal = way.cross(edge);  // of the plane, away from the occluder
  // What rounding of the positions makes of points in one line.
  constexpr double kRounding = 4.0 * std::numeric_limits<double>::epsilon();
  const double rounding =
      kRounding * (x.norm() + v1.norm() + v2.norm()) * (way.norm() + edge.norm());
  if (!(normal.norm() > rounding)) {
    return std::nullopt;
  }
  // Any point of the plane: the nearest of the three to the disk loses least.
  const Vector3d& nearest = std::min(
      {v1, v2, x}, [](const Vector3d& p, const Vector3d& q) { return p.norm() < q.norm(); });
  const double distance = normal.dot(nearest);
  const double slope = normal.head<2>().norm();
  if (slope == 0.0) {
    return DiskLine{.offset = std::copysign(std::numeric_limits<double>::infinity(), distance)};
  }
  return DiskLine{.normal = normal.head<2>() / slope, .offset = distance / (slope * radius)};
}

double line_visibility(const DiskLine& line) {
  return segment_fraction_beyond(std::clamp(line.offset, -1.0, 1.0));
}

}  // namespace haarlight::render
