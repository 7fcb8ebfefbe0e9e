// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/extrusion.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kOnRim = 1e-12;  // of r: a is taken for a point of the rim
constexpr double kNoSide = 1e-6;  // of a length: a root of rounding, and some

/// Signed distance of a point from the plane through an edge that touches the rim in `rim_point`;
/// positive on the side where the disk is not.
double beyond_plane(const Vector2d& rim_point, const Vector3d& edge_point,
                    const Vector3d& point) {
  const Vector3d normal = touching_plane(rim_point, edge_point);
  return normal.dot(point - edge_point) / normal.norm();
}

}  // namespace

/// d = (n x m) x n, normalised, is m's part in the disk's plane, and the signed distances of
/// p_near = c + r d and p_far = c - r d from the face's plane are m.(c - v) +- r |n x m|. With m
/// parallel to n both are that of c.
FaceClass face_class(const Vector3d& normal, const Vector3d& point, double radius) {
  HAARLIGHT_EXPECTS(normal.allFinite() && point.allFinite() && !normal.isZero(0.0),
                    "a finite normal that is not 0, a finite point");
  HAARLIGHT_EXPECTS(radius > 0.0 && std::isfinite(radius), "a radius above 0");
  const double centre = -normal.dot(point);
  const double across = radius * normal.head<2>().norm();
  if (centre + across <= 0.0) {
    return FaceClass::none_front_facing;
  }
  return centre - across >= 0.0 ? FaceClass::all_front_facing : FaceClass::silhouette;
}

Vector3d point_in_disk_plane(const Vector3d& v1, const Vector3d& v2) {
  const Vector3d edge = v2 - v1;
  Vector3d a;
  a << v1.head<2>() * edge.z() - edge.head<2>() * v1.z(), edge.z();
  return a;
}

tl::expected<Extrusion, ExtrusionFault> extrusion_points(const Vector3d& v1, const Vector3d& v2,
                                                         const Vector3d& occluder,
                                                         double radius) {
  HAARLIGHT_EXPECTS(v1.allFinite() && v2.allFinite() && occluder.allFinite(),
                    "finite positions");
  HAARLIGHT_EXPECTS(radius > 0.0 && std::isfinite(radius), "a radius above 0");
  HAARLIGHT_EXPECTS(std::min(v1.z(), v2.z()) >= 0.0 && std::max(v1.z(), v2.z()) > 0.0,
                    "an edge in front of the light");
  if (v1 == v2) {
    return tl::unexpected(ExtrusionFault::no_length);
  }
  const Vector3d a = point_in_disk_plane(v1, v2);
  const double h = a.head<2>().norm();
  const double r_w = radius * std::abs(a.z());
  if (h < r_w * (1.0 - kOnRim)) {
    return tl::unexpected(ExtrusionFault::meets_disk);
  }
  const Vector2d u = a.head<2>() / h;
  const Vector2d u_perp(-u.y(), u.x());
  if (h <= r_w * (1.0 + kOnRim)) {
    const Vector2d rim_point = std::copysign(radius, a.z()) * u;
    return Extrusion{rim_point, rim_point};
  }
  const double cos_phi = radius * a.z() / h;
  const double sin_phi = std::sqrt((h - r_w) * (h + r_w)) / h;
  const std::array<Vector2d, 2> touching{radius * (cos_phi * u + sin_phi * u_perp),
                                         radius * (cos_phi * u - sin_phi * u_perp)};
  const Vector3d& edge_point = v1.z() > v2.z() ? v1 : v2;
  const double first = beyond_plane(touching[0], edge_point, occluder);
  const double second = beyond_plane(touching[1], edge_point, occluder);
  const double rounding = kNoSide * (occluder - edge_point).norm();
  const bool is_parted =
      std::max(first, second) > rounding || std::min(first, second) < -rounding;
  const bool is_aside =
      std::min(first, second) <= rounding && std::max(first, second) >= -rounding;
  if (!is_parted || !is_aside) {
    return tl::unexpected(ExtrusionFault::no_side);
  }
  return first < second ? Extrusion{touching[0], touching[1]}
                        : Extrusion{touching[1], touching[0]};
}

/// normal = (q, k) with q = p/r, the rim's outward normal in the disk's plane, and k such that
/// normal.v = r.
Vector3d touching_plane(const Vector2d& rim_point, const Vector3d& v) {
  HAARLIGHT_EXPECTS(v.z() > 0.0, "a point in front of the light");
  const double radius = rim_point.norm();
  const Vector2d q = rim_point / radius;
  return {q.x(), q.y(), (radius - q.dot(v.head<2>())) / v.z()};
}

double edge_plane_distance(const Vector3d& direction, const Vector3d& v1, const Vector3d& v2) {
  const Vector3d a = point_in_disk_plane(v1, v2);
  HAARLIGHT_EXPECTS(a.head<2>().norm() > 0.0, "an edge whose line misses the centre");
  const Vector3d across = Vector3d::UnitZ().cross(a);
  const Vector3d normal = (v2 - v1).cross(across);
  const Vector3d& edge_point = v1.z() > v2.z() ? v1 : v2;
  const double distance = normal.dot(edge_point) / normal.dot(direction);
  if (!(distance > 0.0)) {
    return kInfinity;
  }
  return distance;
}

double paper_edge_distance(const Vector3d& direction, const Vector3d& v1, const Vector3d& v2) {
  // The nearest point of the edge to the ray's line: both projected along the ray.
  const auto off_ray = [&](const Vector3d& p) {
    return Vector3d(p - direction.dot(p) * direction);
  };
  const Vector3d from = off_ray(v1);
  const Vector3d along = off_ray(v2) - from;
  const double length2 = along.squaredNorm();
  const double part = length2 > 0.0 ? std::clamp(-from.dot(along) / length2, 0.0, 1.0) : 0.0;
  const double height = v1.z() + part * (v2.z() - v1.z());
  return direction.z() > 0.0 ? height / direction.z() : kInfinity;
}

}  // namespace haarlight::render
