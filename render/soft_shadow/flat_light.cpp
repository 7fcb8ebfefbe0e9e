// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/flat_light.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

/// Of a mesh's own size: how far its corners may be off a plane, its outline off convex.
constexpr double kFlat = 1e-6;

double cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

/// The polygon's area, positive where its corners go counter-clockwise.
double signed_area(std::span<const Vector2d> corners) {
  double twice = 0.0;
  for (std::size_t i = 2; i < corners.size(); ++i) {
    twice += cross(corners[i - 1] - corners[0], corners[i] - corners[0]);
  }
  return 0.5 * twice;
}

Vector2d centroid(std::span<const Vector2d> corners) {
  Vector2d sum = Vector2d::Zero();
  double twice = 0.0;
  for (std::size_t i = 2; i < corners.size(); ++i) {
    const double part = cross(corners[i - 1] - corners[0], corners[i] - corners[0]);
    sum += part * (corners[0] + corners[i - 1] + corners[i]) / 3.0;
    twice += part;
  }
  return sum / twice;
}

/// Andrew's monotone chain; counter-clockwise, no corner on a straight side.
std::vector<Vector2d> convex_hull(std::vector<Vector2d> points) {
  std::ranges::sort(points, [](const Vector2d& a, const Vector2d& b) {
    return a.x() != b.x() ? a.x() < b.x() : a.y() < b.y();
  });
  std::vector<Vector2d> hull;
  for (int side = 0; side < 2; ++side) {
    const std::size_t first = hull.size();
    for (const Vector2d& point : points) {
      while (hull.size() >= first + 2 &&
             cross(hull.back() - hull[hull.size() - 2], point - hull.back()) <=
                 1e-12 * (hull.back() - hull[hull.size() - 2]).norm() *
                     (point - hull.back()).norm()) {
        hull.pop_back();
      }
      hull.push_back(point);
    }
    hull.pop_back();
    std::ranges::reverse(points);
  }
  return hull;
}

/// Rows: two directions in the light's plane, and its normal.
Matrix3d frame_of(const Vector3d& normal) {
  Matrix3d frame;
  frame.row(2) = normal.transpose();
  frame.row(0) = normal.unitOrthogonal().transpose();
  frame.row(1) = normal.cross(frame.row(0).transpose()).transpose();
  return frame;
}

/// @param corners  about `light.centre`, mm, counter-clockwise
void set_polygon(FlatLight& light, std::vector<Vector2d> corners, LightShape shape) {
  const Vector2d middle = centroid(corners);
  light.centre += light.light_from_world.transpose() * Vector3d(middle.x(), middle.y(), 0.0);
  if (shape == LightShape::disk) {
    light.radius_mm = std::sqrt(signed_area(corners) / std::numbers::pi);
    return;
  }
  light.radius_mm = 0.0;
  for (Vector2d& corner : corners) {
    corner -= middle;
    light.radius_mm = std::max(light.radius_mm, corner.norm());
  }
  for (Vector2d& corner : corners) {
    corner /= light.radius_mm;
  }
  light.corners = std::move(corners);
}

Error refused(const std::string& what, const std::string& where) {
  return {fmt::format("{} is no flat light: soft shadows are of disks, of convex polygons and "
                      "of LEDs",
                      what),
          where, "make it a [[disk]] or a [[quad]], or use haarlight render surface"};
}

FlatLight light_of(const Mesh& mesh, const std::string& name, LightShape shape,
                   const std::string& where) {
  FlatLight light;
  light.name = name;
  Vector3d twice = Vector3d::Zero();
  double absolute = 0.0;
  for (const Eigen::Vector3i& triangle : mesh.triangles) {
    const Vector3d& a = mesh.vertices[static_cast<std::size_t>(triangle[0])];
    const Vector3d& b = mesh.vertices[static_cast<std::size_t>(triangle[1])];
    const Vector3d& c = mesh.vertices[static_cast<std::size_t>(triangle[2])];
    const Vector3d part = (b - a).cross(c - a);
    twice += part;
    absolute += part.norm();
    light.centre = a;
  }
  // Triangles that overlap or face apart: the vectors' sum is shorter than the sum of lengths.
  if (!(twice.norm() >= (1.0 - kFlat) * absolute) || !(absolute > 0.0)) {
    throw refused(name, where);
  }
  light.light_from_world = frame_of(twice.normalized());
  std::vector<Vector2d> corners;
  double off = 0.0;
  double size = 0.0;
  for (const Eigen::Vector3i& triangle : mesh.triangles) {
    for (const int corner : triangle) {
      const Vector3d point = light.light_from_world *
                             (mesh.vertices[static_cast<std::size_t>(corner)] - light.centre);
      corners.emplace_back(point.head<2>());
      off = std::max(off, std::abs(point.z()));
      size = std::max(size, point.norm());
    }
  }
  std::vector<Vector2d> hull = convex_hull(std::move(corners));
  if (off > kFlat * size || hull.size() < 3 ||
      std::abs(signed_area(hull) - 0.5 * absolute) > kFlat * absolute) {
    throw refused(name, where);
  }
  set_polygon(light, std::move(hull), shape);
  return light;
}

FlatLight light_of(const SquareLight& square, LightShape shape) {
  FlatLight light;
  light.centre = square.centre;
  light.light_from_world = frame_of(square.emits.normalized());
  std::vector<Vector2d> corners;
  for (const auto& [s, t] :
       {std::pair(-1, -1), std::pair(1, -1), std::pair(1, 1), std::pair(-1, 1)}) {
    const Vector3d corner = light.light_from_world * (0.5 * s * square.width_mm * square.u +
                                                      0.5 * t * square.height_mm * square.v);
    corners.emplace_back(corner.head<2>());
  }
  if (signed_area(corners) < 0.0) {
    std::ranges::reverse(corners);
  }
  set_polygon(light, std::move(corners), shape);
  return light;
}

void require_flat(const Scene& scene, const std::string& where) {
  const auto emits = [&scene](int material) {
    return scene.materials[static_cast<std::size_t>(material)].emits.maxCoeff() > 0.0;
  };
  for (std::size_t i = 0; i < scene.spheres.size(); ++i) {
    if (emits(scene.spheres[i].material)) {
      throw refused(fmt::format("sphere {}", i), where);
    }
  }
  if (!scene.point_lights.empty()) {
    throw refused("a point or spot light", where);
  }
  if (!scene.directional_lights.empty()) {
    throw refused("a directional light", where);
  }
  if (scene.environment) {
    throw refused("an environment", where);
  }
}

}  // namespace

double FlatLight::area() const { return is_disk() ? std::numbers::pi : signed_area(corners); }

std::vector<FlatLight> flat_lights(const Scene& scene, LightShape shape,
                                   const std::string& where) {
  HAARLIGHT_EXPECTS(scene.instances.empty(), "instances are expanded");
  require_flat(scene, where);
  const auto emits = [&scene](int material) {
    return scene.materials[static_cast<std::size_t>(material)].emits.maxCoeff() > 0.0;
  };
  std::vector<FlatLight> lights;
  const std::size_t first_disk = scene.meshes.size() + scene.spheres.size();
  for (std::size_t i = 0; i < scene.disks.size(); ++i) {
    const Disk& disk = scene.disks[i];
    if (emits(disk.material)) {
      FlatLight& light = lights.emplace_back();
      light.name = fmt::format("disk {}", i);
      light.centre = disk.centre;
      light.light_from_world = frame_of(disk.normal);
      light.radius_mm = disk.radius_mm;
      light.surface = static_cast<int>(first_disk + i);
    }
  }
  for (std::size_t i = 0; i < scene.meshes.size(); ++i) {
    const Mesh& mesh = scene.meshes[i];
    if (emits(mesh.material)) {
      const std::string name = mesh.name.empty() ? fmt::format("mesh {}", i)
                                                 : fmt::format("mesh {} ({})", i, mesh.name);
      lights.push_back(light_of(mesh, name, shape, where));
      lights.back().surface = static_cast<int>(i);
    }
  }
  for (std::size_t i = 0; i < scene.lights.size(); ++i) {
    lights.push_back(light_of(scene.lights[i], shape));
    lights.back().name = fmt::format("light {}", i);
  }
  if (lights.empty()) {
    throw Error("nothing in the scene emits light", where,
                "give the [[material]] of a [[disk]] or a [[quad]] emits = [red, green, blue]");
  }
  return lights;
}

}  // namespace haarlight::render
