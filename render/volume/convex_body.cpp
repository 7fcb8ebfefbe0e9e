// SPDX-License-Identifier: Apache-2.0
#include "render/volume/convex_body.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <Eigen/Geometry>

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

/// Of the mesh's size: what a cut must leave on either side of its plane.
constexpr double kThinnest = 1e-9;
/// Of the smaller picture of two pieces: what both must cover to hide each other.
constexpr double kLeastOverlap = 1e-10;

/// Of the square of its length: a smaller area is a line.
constexpr double kLine = 1e-9;

using Polygon = std::vector<Vector3d>;
using FlatPolygon = std::vector<Vector2d>;

/// What of the polygon is within [Sutherland74].
Polygon clipped(const Polygon& polygon, const HalfSpace& half) {
  Polygon kept;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Vector3d& from = polygon[i];
    const Vector3d& to = polygon[i + 1 == polygon.size() ? 0 : i + 1];
    const double of_from = half.normal.dot(from) - half.offset;
    const double of_to = half.normal.dot(to) - half.offset;
    if (of_from <= 0.0) {
      kept.push_back(from);
    }
    if ((of_from < 0.0 && of_to > 0.0) || (of_from > 0.0 && of_to < 0.0)) {
      kept.emplace_back(from + of_from / (of_from - of_to) * (to - from));
    }
  }
  return kept;
}

HalfSpace opposite(const HalfSpace& half) {
  return {.normal = -half.normal, .offset = -half.offset};
}

double cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

double area_of(const FlatPolygon& polygon) {
  double sum = 0.0;
  for (std::size_t i = 2; i < polygon.size(); ++i) {
    sum += cross(polygon[i - 1] - polygon[0], polygon[i] - polygon[0]);
  }
  return 0.5 * sum;
}

/// Anticlockwise where y points up: Andrew's monotone chain.
FlatPolygon hull_of(FlatPolygon points) {
  std::ranges::sort(points, [](const Vector2d& a, const Vector2d& b) {
    return a.x() != b.x() ? a.x() < b.x() : a.y() < b.y();
  });
  FlatPolygon hull;
  for (int way = 0; way < 2; ++way) {
    const std::size_t first = hull.size();
    for (const Vector2d& point : points) {
      while (hull.size() >= first + 2 &&
             cross(hull.back() - hull[hull.size() - 2], point - hull.back()) <= 0.0) {
        hull.pop_back();
      }
      hull.push_back(point);
    }
    hull.pop_back();
    std::ranges::reverse(points);
  }
  return hull;
}

/// What two convex polygons, anticlockwise, have in common.
FlatPolygon common_part(FlatPolygon polygon, const FlatPolygon& other) {
  for (std::size_t k = 0; k < other.size() && !polygon.empty(); ++k) {
    const Vector2d& a = other[k];
    const Vector2d along = other[k + 1 == other.size() ? 0 : k + 1] - a;
    FlatPolygon kept;
    for (std::size_t i = 0; i < polygon.size(); ++i) {
      const Vector2d& from = polygon[i];
      const Vector2d& to = polygon[i + 1 == polygon.size() ? 0 : i + 1];
      const double of_from = cross(along, from - a);
      const double of_to = cross(along, to - a);
      if (of_from >= 0.0) {
        kept.push_back(from);
      }
      if ((of_from < 0.0 && of_to > 0.0) || (of_from > 0.0 && of_to < 0.0)) {
        kept.emplace_back(from + of_from / (of_from - of_to) * (to - from));
      }
    }
    polygon = std::move(kept);
  }
  return polygon;
}

/// Without its hull.
ConvexBody clipped(const ConvexBody& body, const HalfSpace& half) {
  ConvexBody kept;
  for (const Polygon& face : body.faces) {
    Polygon polygon = clipped(face, half);
    if (polygon.size() >= 3) {
      kept.faces.push_back(std::move(polygon));
    }
  }
  kept.planes = body.planes;
  kept.planes.push_back(half);
  return kept;
}

FlatPolygon seen_hull(const VolumeView& view, const ConvexBody& body) {
  FlatPolygon points;
  for (const Polygon& face : body.faces) {
    for (const Vector3d& corner : face) {
      const double w = view.projection == Projection::perspective ? corner.z() : 1.0;
      points.emplace_back(corner.x() / w, corner.y() / w);
    }
  }
  return points.empty() ? points : hull_of(std::move(points));
}

/// Where the body is along the ray of a picture point, as its middle.
double middle_of(const VolumeView& view, const ConvexBody& body, const Vector2d& p) {
  const Vector3d origin = view.point_at(p, 0.0);
  const Vector3d along = view.point_at(p, 1.0) - origin;
  double enters = -std::numeric_limits<double>::infinity();
  double leaves = std::numeric_limits<double>::infinity();
  for (const HalfSpace& plane : body.planes) {
    const double slope = plane.normal.dot(along);
    const double z = (plane.offset - plane.normal.dot(origin)) / slope;
    if (slope < 0.0) {
      enters = std::max(enters, z);
    } else if (slope > 0.0) {
      leaves = std::min(leaves, z);
    }
  }
  return 0.5 * enters + 0.5 * leaves;
}

/// The sides of what the picture shows; in perspective what is behind the eye is beyond them.
std::vector<HalfSpace> picture_sides(const VolumeView& view) {
  const bool is_perspective = view.projection == Projection::perspective;
  const double least = is_perspective ? kThinnest * view.size : 0.0;
  std::vector<HalfSpace> sides = {
      {.normal = -Vector3d::UnitZ(), .offset = -std::max(view.near, least)}};
  if (std::isfinite(view.far)) {
    sides.push_back({.normal = Vector3d::UnitZ(), .offset = view.far});
  }
  // Half a pixel about the centres of the outermost.
  const Vector2d pixel = view.ray(1, 1) - view.ray(0, 0);
  const Vector2d first = view.ray(0, 0) - 0.5 * pixel;
  const Vector2d last = first + Vector2d(view.scene.camera.width * pixel.x(),
                                         view.scene.camera.height * pixel.y());
  for (const int axis : {0, 1}) {
    const auto add = [&](double at, double sign) {
      Vector3d normal = sign * Vector3d::Unit(axis);
      if (is_perspective) {
        normal.z() = -sign * at;
        sides.push_back({.normal = normal.normalized(), .offset = 0.0});
      } else {
        sides.push_back({.normal = normal, .offset = sign * at});
      }
    };
    add(std::min(first[axis], last[axis]), -1.0);
    add(std::max(first[axis], last[axis]), 1.0);
  }
  return sides;
}

}  // namespace

ConvexBody body_of(const VolumeView& view, std::uint32_t cell) {
  const auto position_of = [&view](std::uint32_t node) {
    const SeenPoint& seen = view.points[node].seen;
    return Vector3d(seen.x, seen.y, seen.z);
  };
  ConvexBody body;
  for (std::uint32_t i = view.mesh.begins[cell]; i < view.mesh.begins[cell + 1]; ++i) {
    const std::array<std::uint32_t, 3>& nodes = view.mesh.faces[i].nodes;
    const Vector3d a = position_of(nodes[0]);
    const Vector3d b = position_of(nodes[1]);
    const Vector3d c = position_of(nodes[2]);
    const Vector3d normal = (b - a).cross(c - a).normalized();
    body.faces.push_back({a, b, c});
    body.planes.push_back({.normal = normal, .offset = normal.dot(a)});
  }
  for (const HalfSpace& side : picture_sides(view)) {
    const bool is_within = std::ranges::all_of(body.faces, [&side](const Polygon& face) {
      return std::ranges::all_of(face, [&side](const Vector3d& corner) {
        return side.normal.dot(corner) <= side.offset;
      });
    });
    if (!is_within) {
      body = clipped(body, side);
    }
  }
  body.hull = seen_hull(view, body);
  return body;
}

std::optional<std::array<ConvexBody, 2>> cut(const VolumeView& view, const ConvexBody& body,
                                             const HalfSpace& half) {
  double low = 0.0;
  double high = 0.0;
  for (const Polygon& face : body.faces) {
    for (const Vector3d& corner : face) {
      const double beyond = half.normal.dot(corner) - half.offset;
      low = std::min(low, beyond);
      high = std::max(high, beyond);
    }
  }
  const double thinnest = kThinnest * view.size;
  if (low > -thinnest || high < thinnest) {
    return std::nullopt;
  }
  std::array<ConvexBody, 2> parts = {clipped(body, half), clipped(body, opposite(half))};
  for (ConvexBody& part : parts) {
    part.hull = seen_hull(view, part);
  }
  return parts;
}

bool hides(const VolumeView& view, const ConvexBody& a, const ConvexBody& b) {
  if (a.hull.size() < 3 || b.hull.size() < 3) {
    return false;
  }
  const FlatPolygon common = common_part(a.hull, b.hull);
  const double area = area_of(common);
  if (!(area > kLeastOverlap * std::min(area_of(a.hull), area_of(b.hull)))) {
    return false;
  }
  Vector2d middle = Vector2d::Zero();
  double length = 0.0;
  for (const Vector2d& corner : common) {
    middle += corner;
    length = std::max(length, (corner - common[0]).squaredNorm());
  }
  const double picture = view.picture_size();
  if (!(area > kLine * length && length > kThinnest * kThinnest * picture * picture)) {
    return false;
  }
  middle /= static_cast<double>(common.size());
  return middle_of(view, a, middle) < middle_of(view, b, middle);
}

}  // namespace haarlight::render
