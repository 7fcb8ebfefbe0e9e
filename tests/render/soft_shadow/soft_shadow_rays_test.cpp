// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/soft_shadow/soft_shadow.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

constexpr int kDark = 0;
constexpr int kBright = 1;

Scene scene_with_materials() {
  Scene scene;
  scene.materials.resize(2);
  scene.materials[kBright].emits = Vector3d::Ones();
  return scene;
}

enum class Kind { disk, quad };

/// A light at `height` over the origin that shines down.
Scene scene_under(Kind kind, double height, double radius) {
  Scene scene = scene_with_materials();
  if (kind == Kind::disk) {
    scene.disks.push_back({.centre = {0.0, 0.0, height},
                           .normal = -Vector3d::UnitZ(),
                           .radius_mm = radius,
                           .material = kBright});
  } else {
    const double half = radius * std::sqrt(0.5);
    scene.meshes.push_back(make_quad({-half, -half, height}, {-half, half, height},
                                     {half, half, height}, {half, -half, height}, kBright));
  }
  return scene;
}

/// A grid of points over the square [-half, half]^2 of the plane z = 0.
std::vector<Vector3d> floor_points(int n, double half) {
  std::vector<Vector3d> points;
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      points.emplace_back(half * (2.0 * (i + 0.5) / n - 1.0),
                          half * (2.0 * (j + 0.5) / n - 1.0), 0.0);
    }
  }
  return points;
}

struct Result {
  std::vector<LightShadow> shadows;
  ShadowCounts counts;
};
Result shadows_of(const Scene& scene, const std::vector<Vector3d>& points,
                  const SoftShadowOptions& options = {}) {
  const RayCaster caster(scene);
  const OccluderEdges edges = occluder_edges(scene.meshes);
  std::vector<FlatLight> lights = flat_lights(scene, LightShape::own, "the test");
  SoftShadow soft(scene, edges, caster, std::move(lights.at(0)), options, "the test");
  Result result;
  result.shadows.resize(points.size());
  soft.evaluate(points, result.shadows);
  result.counts = soft.counts();
  return result;
}

/// The same fraction by n x n rays to the middles of equal parts of the light: in double precision,
/// triangle by triangle.
double counted(const Scene& scene, Kind kind, double height, double radius,
               const Vector3d& point, int n) {
  struct Triangle {
    Vector3d normal;
    double depth;
    Vector3d ab;  // across the planes through the point and each side
    Vector3d bc;
    Vector3d ca;
  };
  std::vector<Triangle> triangles;
  for (const Mesh& mesh : scene.meshes) {
    if (mesh.material == kBright) {
      continue;
    }
    for (const Eigen::Vector3i& t : mesh.triangles) {
      const Vector3d a = mesh.vertices[static_cast<std::size_t>(t[0])] - point;
      const Vector3d b = mesh.vertices[static_cast<std::size_t>(t[1])] - point;
      const Vector3d c = mesh.vertices[static_cast<std::size_t>(t[2])] - point;
      const Vector3d normal = (b - a).cross(c - a);
      triangles.push_back({normal, normal.dot(a), a.cross(b), b.cross(c), c.cross(a)});
    }
  }
  int n_seen = 0;
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      const double u = (i + 0.5) / n;
      const double v = (j + 0.5) / n;
      Vector3d target(0.0, 0.0, height);
      if (kind == Kind::disk) {
        const double angle = 2.0 * std::numbers::pi * v;
        target += radius * std::sqrt(u) * Vector3d(std::cos(angle), std::sin(angle), 0.0);
      } else {
        target += radius * std::sqrt(2.0) * Vector3d(u - 0.5, v - 0.5, 0.0);
      }
      const Vector3d way = target - point;
      const bool is_blocked = std::ranges::any_of(triangles, [&way](const Triangle& t) {
        const double s = t.depth / t.normal.dot(way);
        const double p = way.dot(t.ab);
        const double q = way.dot(t.bc);
        const double r = way.dot(t.ca);
        return s > 0.0 && s < 1.0 && ((p > 0 && q > 0 && r > 0) || (p < 0 && q < 0 && r < 0));
      });
      n_seen += is_blocked ? 0 : 1;
    }
  }
  return static_cast<double>(n_seen) / (n * n);
}

/// Any triangles at all: open, through one another, back to back, three at an edge, behind the
/// point and beyond the light's plane.
Scene soup(Kind kind, double height, double radius, std::uint64_t seed) {
  Scene scene = scene_under(kind, height, radius);
  std::uint64_t i = 0;
  const auto random = [&] { return uniform_unit(hash_key(seed, i++)); };
  Mesh mesh;
  const int n_vertices = 4 + static_cast<int>(8.0 * random());
  for (int v = 0; v < n_vertices; ++v) {
    mesh.vertices.emplace_back(2.0 * random() - 1.0, 2.0 * random() - 1.0,
                               height * (1.3 * random() - 0.15));
  }
  const int n_triangles = 1 + static_cast<int>(7.0 * random());
  for (int t = 0; t < n_triangles; ++t) {
    Eigen::Vector3i triangle;
    for (int c = 0; c < 3; ++c) {
      triangle[c] = static_cast<int>(n_vertices * random());
    }
    if (triangle[0] != triangle[1] && triangle[1] != triangle[2] &&
        triangle[2] != triangle[0]) {
      mesh.triangles.push_back(triangle);
    }
  }
  if (mesh.triangles.empty()) {
    mesh.triangles.emplace_back(0, 1, 2);
  }
  mesh.material = kDark;
  scene.meshes.push_back(mesh);
  return scene;
}

class SoftShadowOf : public testing::TestWithParam<Kind> {};

/// The error of n x n points: each border crosses about 4 n of the strata, half of each in doubt.
TEST_P(SoftShadowOf, AnyTrianglesIsWhatRaysCount) {
  constexpr int kRays = 48;
  int n_exact = 0;
  int n_penumbra = 0;
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    const double height = 2.0;
    const double radius = 0.2 + 0.1 * static_cast<double>(seed % 7);
    const Scene scene = soup(GetParam(), height, radius, seed);
    const std::vector<Vector3d> points = floor_points(4, 1.0);
    const Result result = shadows_of(scene, points, {.grid = 16});
    for (std::size_t i = 0; i < points.size(); ++i) {
      const LightShadow& shadow = result.shadows[i];
      if (shadow.kind == ShadowKind::traced || shadow.kind == ShadowKind::unsure) {
        continue;
      }
      ++n_exact;
      const double truth = counted(scene, GetParam(), height, radius, points[i], kRays);
      n_penumbra += truth > 0.0 && truth < 1.0 ? 1 : 0;
      EXPECT_NEAR(shadow.visibility, truth, 1.0 / kRays) << "seed " << seed << ", point " << i;
    }
  }
  EXPECT_GT(n_exact, 500);
  EXPECT_GT(n_penumbra, 100);
}

INSTANTIATE_TEST_SUITE_P(Lights, SoftShadowOf, testing::Values(Kind::disk, Kind::quad),
                         [](const auto& instance) {
                           return instance.param == Kind::disk ? "disk" : "quad";
                         });

}  // namespace
}  // namespace haarlight::render
