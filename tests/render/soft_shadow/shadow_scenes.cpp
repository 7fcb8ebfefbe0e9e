// SPDX-License-Identifier: Apache-2.0
#include "tests/render/soft_shadow/shadow_scenes.h"

#include <utility>

#include <Eigen/Geometry>

namespace haarlight::test {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using render::Mesh;

void ShadowScene::add(const Mesh& mesh) {
  scene.meshes.push_back(mesh);
  pieces.push_back(convex_piece_of(mesh));
}

double ShadowScene::truth(const Vector3d& point) const {
  std::vector<ConvexPiece> before = pieces;
  for (ConvexPiece& piece : before) {
    for (std::vector<Vector3d>& face : piece) {
      for (Vector3d& corner : face) {
        corner = light_from_world * (corner - centre);
      }
    }
  }
  const Vector3d x = light_from_world * (point - centre);
  if (light == LightKind::disk) {
    return true_disk_visibility(before, x, radius);
  }
  return true_polygon_visibility(
      before, x, {{-radius, -radius}, {radius, -radius}, {radius, radius}, {-radius, radius}});
}

ShadowScene scene_under_light(LightKind light, const Vector3d& centre,
                              const Matrix3d& light_from_world, double radius) {
  ShadowScene made;
  made.scene.materials.resize(2);
  made.scene.materials[kBright].emits = Vector3d::Ones();
  made.light = light;
  made.centre = centre;
  made.light_from_world = light_from_world;
  made.radius = radius;
  const Vector3d u = light_from_world.row(0).transpose();
  const Vector3d v = light_from_world.row(1).transpose();
  const Vector3d n = light_from_world.row(2).transpose();
  if (light == LightKind::disk) {
    made.scene.disks.push_back(
        {.centre = centre, .normal = n, .radius_mm = radius, .material = kBright});
  } else if (light == LightKind::square_mesh) {
    const auto at = [&](double s, double t) -> Vector3d {
      return centre + radius * (s * u + t * v);
    };
    made.scene.meshes.push_back(
        render::make_quad(at(-1, -1), at(1, -1), at(1, 1), at(-1, 1), kBright));
  } else {
    made.scene.lights.push_back({.centre = centre,
                                 .u = u,
                                 .v = v,
                                 .emits = n,
                                 .width_mm = 2.0 * radius,
                                 .height_mm = 2.0 * radius});
  }
  return made;
}

ShadowScene scene_under_light(LightKind light, double height, double radius) {
  return scene_under_light(light, {0.0, 0.0, height},
                           Vector3d(1.0, -1.0, -1.0).asDiagonal().toDenseMatrix(), radius);
}

Mesh hull_of(const std::vector<Vector3d>& points) {
  Mesh mesh;
  mesh.vertices = points;
  const int n = static_cast<int>(points.size());
  const auto at = [&](int i) { return points[static_cast<std::size_t>(i)]; };
  for (int a = 0; a < n; ++a) {
    for (int b = a + 1; b < n; ++b) {
      for (int c = b + 1; c < n; ++c) {
        const Vector3d normal = (at(b) - at(a)).cross(at(c) - at(a));
        int n_before = 0;
        for (int d = 0; d < n; ++d) {
          n_before += d != a && d != b && d != c && normal.dot(at(d) - at(a)) > 0.0 ? 1 : 0;
        }
        if (n_before == 0) {
          mesh.triangles.emplace_back(a, b, c);
        } else if (n_before == n - 3) {
          mesh.triangles.emplace_back(a, c, b);
        }
      }
    }
  }
  return mesh;
}

ShadowValues shadow_values(const render::Scene& scene, const std::vector<Vector3d>& points,
                           const render::SoftShadowOptions& options) {
  const render::RayCaster caster(scene);
  const render::OccluderEdges edges = render::occluder_edges(scene.meshes);
  std::vector<render::FlatLight> lights =
      render::flat_lights(scene, render::LightShape::own, "the test");
  render::SoftShadow soft(scene, edges, caster, std::move(lights.at(0)), options, "the test");
  ShadowValues values;
  values.shadows.resize(points.size());
  soft.evaluate(points, values.shadows);
  values.counts = soft.counts();
  return values;
}

}  // namespace haarlight::test
