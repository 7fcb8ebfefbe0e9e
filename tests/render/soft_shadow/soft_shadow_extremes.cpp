// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "tests/extremes.h"
#include "tests/render/soft_shadow/shadow_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using extremes::bounded;
using extremes::exact;
using extremes::stated;
using test::kDark;
using test::LightKind;
using test::scene_under_light;
using test::ShadowScene;

constexpr double kExact = 1e-6;  // what exact stands for
constexpr auto kWhy =
    "areas of less than 1e-7 that are left out, and the float that keeps the value";
constexpr std::array kLights = {LightKind::disk, LightKind::square_mesh, LightKind::led};

std::vector<Vector3d> floor_line(double half) {
  constexpr int kPoints = 200;
  std::vector<Vector3d> points;
  for (int i = 0; i < kPoints; ++i) {
    points.emplace_back(half * (2.0 * (i + 0.5) / kPoints - 1.0), 0.013 * half, 0.0);
  }
  return points;
}

/// The largest error of values that are called exact.
double worst_error(const ShadowScene& made, const std::vector<Vector3d>& points) {
  const test::ShadowValues values = test::shadow_values(made.scene, points);
  double worst = 0.0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (test::is_exact(values.shadows[i].kind)) {
      worst = std::max(worst, std::abs(values.shadows[i].visibility - made.truth(points[i])));
    }
  }
  return worst;
}

Mesh tilted_box(double scale) {
  Mesh box = make_box({-0.3, -0.2, -0.15}, {0.3, 0.2, 0.15}, kDark);
  for (Vector3d& vertex : box.vertices) {
    vertex = scale * (Eigen::AngleAxisd(0.6, Vector3d(1, 2, 3).normalized()) * vertex +
                      Vector3d(0.05, 0.02, 1.0));
  }
  return box;
}

Mesh one_triangle() {
  Mesh mesh;
  mesh.vertices = {{-0.2, -0.2, 1.0}, {0.3, -0.1, 1.1}, {0.0, 0.25, 0.9}};
  mesh.triangles = {{0, 1, 2}};
  mesh.material = kDark;
  return mesh;
}

EXTREMES_OF(soft_shadow, "render/soft_shadow", "soft shadow of a flat light, by all edges")

EXTREME(soft_shadow, dark) {
  for (const LightKind light : kLights) {
    const ShadowScene made = scene_under_light(light, 2.0, 0.3);
    for (const LightShadow& shadow : test::shadow_values(made.scene, floor_line(1.0)).shadows) {
      EXPECT_EQ(shadow.visibility, 1.0F);
    }
  }
  return exact("nothing in the way: 1");
}
EXTREME(soft_shadow, one) {
  double worst = 0.0;
  for (const LightKind light : kLights) {
    ShadowScene made = scene_under_light(light, 2.0, 0.3);
    made.add(one_triangle());
    worst = std::max(worst, worst_error(made, floor_line(1.0)));
  }
  return bounded(worst, kExact, "one open triangle: error", kWhy);
}
EXTREME(soft_shadow, largest) {
  ShadowScene made = scene_under_light(LightKind::disk, 2.0, 0.3);
  constexpr int kTriangles = 600;
  Mesh comb = one_triangle();
  comb.vertices.clear();
  comb.triangles.clear();
  for (int i = 0; i < kTriangles; ++i) {
    const double x = -0.3 + 0.6 * i / kTriangles;
    comb.vertices.insert(comb.vertices.end(),
                         {{x, -0.3, 1.0}, {x + 0.3 / kTriangles, -0.3, 1.0}, {x, 0.3, 1.0}});
    comb.triangles.emplace_back(3 * i, 3 * i + 1, 3 * i + 2);
  }
  made.scene.meshes.push_back(comb);
  EXPECT_EQ(test::shadow_values(made.scene, {Vector3d::Zero()}).shadows[0].kind,
            ShadowKind::traced);
  return stated("more than 512 edges that part the light at one point: traced, and marked so");
}
EXTREME(soft_shadow, odd_size) {
  ShadowScene made = scene_under_light(LightKind::disk, 2.0, 0.3);
  made.add(tilted_box(1.0));
  const std::vector<Vector3d> points = floor_line(1.0);
  const std::vector<LightShadow> first = test::shadow_values(made.scene, points).shadows;
  for (const int grid : {1, 3, 7, 1000}) {
    const std::vector<LightShadow> other =
        test::shadow_values(made.scene, points, {.grid = grid}).shadows;
    for (std::size_t i = 0; i < points.size(); ++i) {
      EXPECT_EQ(first[i].visibility, other[i].visibility) << grid;
    }
  }
  return exact("1, 3, 7 or 1000 cells across: the same bits");
}
EXTREME(soft_shadow, scale) {
  double worst = 0.0;
  for (const double scale : {1e-6, 1e6}) {
    for (const LightKind light : kLights) {
      ShadowScene made = scene_under_light(light, 2.0 * scale, 0.3 * scale);
      made.add(tilted_box(scale));
      worst = std::max(worst, worst_error(made, floor_line(scale)));
    }
  }
  return bounded(worst, kExact, "all lengths times 1e-6 and 1e6: error", kWhy);
}
NO_EXTREME(soft_shadow, subnormal, "lengths in mm; 1e±6 of them before this")
NO_EXTREME(soft_shadow, not_finite, "the readers of scenes refuse such positions")
EXTREME(soft_shadow, degenerate) {
  for (const LightKind light : kLights) {
    ShadowScene made = scene_under_light(light, 2.0, 0.3);
    Mesh line = one_triangle();
    line.vertices[2] = 0.5 * (line.vertices[0] + line.vertices[1]);
    made.scene.meshes.push_back(line);
    const std::vector<LightShadow> shadows =
        test::shadow_values(made.scene, {{0, 0, 0}, {0.9, 0, 2.0}, {0, 0, 2.5}}).shadows;
    EXPECT_EQ(shadows[0].visibility, 1.0F);
    EXPECT_EQ(shadows[1].visibility, 0.0F);
    EXPECT_EQ(shadows[2].visibility, 0.0F);
    // A sheet at the light, then at the point.
    for (const double z : {2.0 - 1e-9, 1e-9}) {
      ShadowScene covered = scene_under_light(light, 2.0, 0.3);
      covered.add(make_quad({-1, -1, z}, {1, -1, z}, {1, 1, z}, {-1, 1, z}, kDark));
      const LightShadow shadow =
          test::shadow_values(covered.scene, {{0.1, 0.03, 0.0}}).shadows[0];
      EXPECT_EQ(shadow.visibility, 0.0F) << z;
      EXPECT_EQ(shadow.kind, ShadowKind::whole) << z;
    }
  }
  return exact(
      "a triangle without area hides nothing; in the light's plane and behind it: 0; a sheet "
      "1e-9 before "
      "the light or the point: 0");
}
EXTREME(soft_shadow, grazing) {
  double worst = 0.0;
  for (const LightKind light : kLights) {
    ShadowScene made = scene_under_light(light, 2.0, 0.3);
    made.add(make_box({1.0, -0.2, 1.5}, {1.2, 0.1, 2.5}, kDark));
    std::vector<Vector3d> points;
    for (int i = 0; i < 100; ++i) {
      points.emplace_back(3.0, -0.6 + 0.012 * i, 2.0 - 1e-4);
    }
    worst = std::max(worst, worst_error(made, points));
  }
  return bounded(worst, kExact, "3e-5 rad before the light's plane: error", kWhy);
}
EXTREME(soft_shadow, far_near) {
  double worst = 0.0;
  for (const LightKind light : kLights) {
    for (const double radius : {1e-6, 1e-3, 1.0, 1e3}) {
      ShadowScene made = scene_under_light(light, 2.0, radius);
      made.add(tilted_box(1.0));
      worst = std::max(worst, worst_error(made, floor_line(1.0)));
    }
  }
  return bounded(worst, kExact,
                 "lights from 5e-7 to 500 of their distance, error of what is called exact",
                 kWhy);
}
EXTREME(soft_shadow, duplicate) {
  double worst = 0.0;
  for (const LightKind light : kLights) {
    ShadowScene made = scene_under_light(light, 2.0, 0.3);
    made.add(tilted_box(1.0));
    made.scene.meshes.push_back(tilted_box(1.0));
    worst = std::max(worst, worst_error(made, floor_line(1.0)));
  }
  return bounded(worst, kExact, "every triangle twice: error", kWhy);
}
NO_EXTREME(soft_shadow, clipped, "it knows no samples")

}  // namespace
}  // namespace haarlight::render
