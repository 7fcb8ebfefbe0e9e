// SPDX-License-Identifier: Apache-2.0
/// @file
/// Soft shadows where sizes and geometry are at their limits. Bounds of 1e-6 are what exact stands
/// for: 1e-7 that is ignored, and single precision, with a margin.

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "tests/drawn_seed.h"
#include "tests/render/soft_shadow/shadow_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using test::kDark;
using test::LightKind;
using test::scene_under_light;
using test::ShadowScene;

constexpr double kExact = 1e-6;
constexpr std::array kLights = {LightKind::disk, LightKind::square_mesh, LightKind::led};

/// Values in [0, 1], and those called exact within 1e-6. @return how many are exact
int expect_true(const ShadowScene& made, const std::vector<Vector3d>& points,
                const std::string& what, const SoftShadowOptions& options = {}) {
  const test::ShadowValues values = test::shadow_values(made.scene, points, options);
  int n_exact = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const LightShadow& shadow = values.shadows[i];
    EXPECT_TRUE(shadow.visibility >= 0.0F && shadow.visibility <= 1.0F) << what;
    if (test::is_exact(shadow.kind)) {
      ++n_exact;
      EXPECT_NEAR(shadow.visibility, made.truth(points[i]), kExact)
          << what << ", point " << points[i].transpose() << ", "
          << kShadowKindWords.at(static_cast<std::size_t>(shadow.kind));
    }
  }
  return n_exact;
}

Mesh turned(Mesh mesh, double angle, const Vector3d& axis, const Vector3d& middle) {
  const Matrix3d turn = Eigen::AngleAxisd(angle, axis.normalized()).toRotationMatrix();
  for (Vector3d& vertex : mesh.vertices) {
    vertex = middle + turn * vertex;
  }
  return mesh;
}

Mesh tilted_box() {
  return turned(make_box({-0.3, -0.2, -0.15}, {0.3, 0.2, 0.15}, kDark), 0.6, {1, 2, 3},
                {0.05, 0.02, 1.0});
}

std::vector<Vector3d> points_on_line(double from, double to, int n) {
  std::vector<Vector3d> points;
  for (int i = 0; i < n; ++i) {
    points.emplace_back(from + (to - from) * (i + 0.5) / n, 0.013, 0.0);
  }
  return points;
}

TEST(SoftShadowExtremes, RadiusFromAMillionthToAThousandTimesTheDistance) {
  for (const LightKind light : kLights) {
    for (const double radius : {1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1.0, 10.0, 100.0, 1000.0}) {
      ShadowScene made = scene_under_light(light, 2.0, radius);
      made.add(tilted_box());
      std::vector<Vector3d> points = points_on_line(-1.0, 1.0, 200);
      // And about the border, a few radii wide.
      const double border = 2.0 * 0.35;
      for (const Vector3d& point : points_on_line(border - 1e-2, border + 1e-2, 400)) {
        points.push_back(point);
      }
      expect_true(made, points, "radius " + std::to_string(radius));
    }
  }
}

/// About the true border of a small light, found by bisection, nearer than a ray resolves.
TEST(SoftShadowExtremes, ASmallLightsBorderIsNotCalledExactWhereRaysAreWrong) {
  for (const LightKind light : kLights) {
    for (const double radius : {1e-7, 1e-6, 1e-5, 1e-4, 1e-3}) {
      ShadowScene made = scene_under_light(light, 2.0, radius);
      made.add(tilted_box());
      double low = 0.0;
      double high = 1.5;
      for (int i = 0; i < 60; ++i) {
        const double middle = 0.5 * (low + high);
        (made.truth({middle, 0.013, 0.0}) < 0.5 ? low : high) = middle;
      }
      std::vector<Vector3d> points;
      for (int i = -300; i <= 300; ++i) {
        points.emplace_back(low + i * 0.02 * radius, 0.013, 0.0);
        points.emplace_back(low + i * 2e-9, 0.013, 0.0);
      }
      expect_true(made, points, "radius " + std::to_string(radius * 1e6) + "e-6");
    }
  }
}

/// Exact from RayCaster::offset_mm() off all surfaces, as points are documented to be. Nearer, a ray may
/// begin on the other side of the surface, which no kind tells: held to [0, 1] alone.
TEST(SoftShadowExtremes, ReceiverNextToAContact) {
  for (const LightKind light : kLights) {
    ShadowScene made = scene_under_light(light, 2.0, 0.4);
    made.add(make_box({-0.25, -0.25, 0.0}, {0.25, 0.25, 0.5}, kDark));
    ShadowScene above = scene_under_light(light, 2.0, 0.4);
    above.add(tilted_box());
    const Vector3d low = *std::ranges::min_element(above.scene.meshes.back().vertices, {},
                                                   [](const Vector3d& v) { return v.z(); });
    const auto offset_of = [](const ShadowScene& scene) {
      const RayCaster caster(scene.scene);
      return caster.most_offset_mm(static_cast<std::uint32_t>(scene.scene.meshes.size() - 1));
    };
    const double offset = std::max(offset_of(made), offset_of(above));
    EXPECT_LT(offset, 0.5e-5);  // 1e-5 of the size
    for (int k = 3; k <= 9; ++k) {
      const double gap = 0.5 * std::pow(10.0, -k);
      const std::vector<Vector3d> beside = {
          {0.25 + gap, 0.1, 0.0}, {0.25 + gap, 0.25 + gap, 0.0}, {0.0, -0.25 - gap, 1e-7}};
      const std::vector<Vector3d> below = {low - gap * Vector3d(0, 0, 2),
                                           low + gap * Vector3d(1, 0, -2),
                                           low + gap * Vector3d(0, 1, -2)};
      if (gap >= offset) {
        expect_true(made, beside, "beside a box");
        expect_true(above, below, "below a corner");
        continue;
      }
      for (const auto& [scene, points] :
           {std::pair(&made, &beside), std::pair(&above, &below)}) {
        for (const LightShadow& shadow : test::shadow_values(scene->scene, *points).shadows) {
          EXPECT_TRUE(shadow.visibility >= 0.0F && shadow.visibility <= 1.0F);
        }
      }
    }
  }
}

TEST(SoftShadowExtremes, EdgesThroughTheAxisParallelAndAtTheRim) {
  for (const LightKind light : kLights) {
    for (const double at : {0.0, 1e-16, 0.125, 0.125 * (1.0 - 1e-12), 0.125 * (1.0 + 1e-12),
                            -0.125, -0.125 * (1.0 - 1e-12), -0.125 * (1.0 + 1e-12)}) {
      // Half-way up: the edge's line on the light is at 2 at, 0.25 being its rim.
      ShadowScene made = scene_under_light(light, 2.0, 0.25);
      made.add(make_box({at, -2.0, 1.0}, {3.0, 2.0, 1.5}, kDark));
      expect_true(made, {Vector3d::Zero(), {0.0, 0.3, 0.0}, {1e-12, 0.0, 0.0}}, "at the rim");
    }
    // An edge along the axis: the box stands under the light's middle.
    ShadowScene made = scene_under_light(light, 2.0, 0.25);
    made.add(make_box({0.0, 0.0, 0.5}, {1.0, 1.0, 1.5}, kDark));
    expect_true(made,
                {Vector3d::Zero(),
                 {0.1, 0.0, 0.0},
                 {0.0, 0.1, 0.0},
                 {-0.1, 0.0, 0.0},
                 {-0.1, -0.1, 0.0},
                 {1e-12, -1e-12, 0.0},
                 {-1e-9, 1e-9, 0.0}},
                "an edge along the axis");
  }
}

TEST(SoftShadowExtremes, LightInAClosedBoxAndBehind) {
  for (const LightKind light : kLights) {
    ShadowScene made = scene_under_light(light, 2.0, 0.25);
    made.scene.meshes.push_back(make_box({-1, -1, 1.0}, {1, 1, 3.0}, kDark));
    const test::ShadowValues values = test::shadow_values(made.scene, {{0.0, 0.0, 0.0},
                                                                       {3.0, 0.0, 0.0},
                                                                       {0.0, 0.0, 0.99},
                                                                       {0.0, 0.0, 1.01},
                                                                       {0.9, 0.9, 1.5},
                                                                       {-0.9, 0.3, 1.9},
                                                                       {0.0, 0.0, 2.5},
                                                                       {0.0, 0.0, 2.0}});
    const std::array expected = {0.0F, 0.0F, 0.0F, 1.0F, 1.0F, 1.0F, 0.0F, 0.0F};
    for (std::size_t i = 0; i < expected.size(); ++i) {
      EXPECT_EQ(values.shadows[i].visibility, expected.at(i)) << i;
    }
  }
}

/// Points of all triangles that face the whole light, off their surface as the renderer's are.
void expect_no_acne(ShadowScene made, const Mesh& mesh, const std::string& what) {
  made.scene.meshes.push_back(mesh);
  const RayCaster caster(made.scene);
  const auto surface = static_cast<std::uint32_t>(made.scene.meshes.size() - 1);
  std::vector<Vector3d> points;
  for (std::uint32_t t = 0; t < mesh.triangles.size(); ++t) {
    const auto corner = [&](int c) {
      return mesh.vertices[static_cast<std::size_t>(mesh.triangles[t][c])];
    };
    const Vector3d normal = (corner(1) - corner(0)).cross(corner(2) - corner(0)).normalized();
    const Vector3d up = made.light_from_world.row(2).transpose();
    const double spread =
        made.radius * std::numbers::sqrt2 * (normal - normal.dot(up) * up).norm();
    if (normal.dot(made.centre - corner(0)) < spread + 1e-3) {
      continue;
    }
    for (const Vector3d& w : {Vector3d(1, 1, 1), Vector3d(98, 1, 1), Vector3d(1, 98, 1),
                              Vector3d(1, 1, 1e-6), Vector3d(1, 1e-6, 1), Vector3d(1, 0, 0)}) {
      const Vector3d point = (w[0] * corner(0) + w[1] * corner(1) + w[2] * corner(2)) / w.sum();
      points.emplace_back(point + caster.offset_mm(surface, t, point) * normal);
    }
  }
  EXPECT_GT(points.size(), 10U) << what;
  const test::ShadowValues values = test::shadow_values(made.scene, points);
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_EQ(values.shadows[i].visibility, 1.0F)
        << what << ": " << points[i].transpose() << ", "
        << kShadowKindWords.at(static_cast<std::size_t>(values.shadows[i].kind));
  }
}

TEST(SoftShadowExtremes, LitFacesOfConvexMeshesDoNotShadowThemselves) {
  for (const LightKind light : kLights) {
    expect_no_acne(scene_under_light(light, 2.0, 0.25), tilted_box(), "a box");
    expect_no_acne(scene_under_light(light, 2.0, 0.25),
                   make_sphere({0.1, 0.05, 0.7}, 0.4, 4, kDark), "a sphere");
  }
}

TEST(SoftShadowExtremes, ScaledByAMillionUpAndDown) {
  for (const LightKind light : kLights) {
    std::vector<float> first;
    for (const double scale : {1.0, 1e6, 1e-6}) {
      ShadowScene made = scene_under_light(light, 2.0 * scale, 0.3 * scale);
      Mesh box = tilted_box();
      for (Vector3d& vertex : box.vertices) {
        vertex *= scale;
      }
      made.add(box);
      std::vector<Vector3d> points = points_on_line(-1.5, 1.5, 301);
      for (Vector3d& point : points) {
        point *= scale;
      }
      EXPECT_GT(expect_true(made, points, "scale"), 295);
      const test::ShadowValues values = test::shadow_values(made.scene, points);
      for (std::size_t i = 0; i < points.size(); ++i) {
        if (scale == 1.0) {
          first.push_back(values.shadows[i].visibility);
        } else if (test::is_exact(values.shadows[i].kind)) {
          EXPECT_NEAR(values.shadows[i].visibility, first[i], 1e-5) << scale << " " << i;
        }
      }
    }
  }
}

/// The same solid by other triangles: none of it changes what is hidden.
TEST(SoftShadowExtremes, DegenerateDuplicatedAndTJunctions) {
  const auto with = [](const std::vector<Eigen::Vector3i>& triangles,
                       const std::vector<Vector3d>& vertices) {
    Mesh mesh = tilted_box();
    mesh.vertices.insert(mesh.vertices.end(), vertices.begin(), vertices.end());
    mesh.triangles.insert(mesh.triangles.end(), triangles.begin(), triangles.end());
    return mesh;
  };
  const Mesh box = tilted_box();
  const Eigen::Vector3i t0 = box.triangles[0];
  std::vector<Eigen::Vector3i> all = box.triangles;
  std::vector<Eigen::Vector3i> reversed;
  for (const Eigen::Vector3i& t : all) {
    reversed.emplace_back(t[0], t[2], t[1]);
  }
  const Vector3d half = 0.5 * (box.vertices[static_cast<std::size_t>(t0[0])] +
                               box.vertices[static_cast<std::size_t>(t0[1])]);
  Mesh split = with({}, {half});  // one face is halved, its neighbour is not
  split.triangles[0] = {t0[0], 8, t0[2]};
  split.triangles.emplace_back(8, t0[1], t0[2]);
  const std::vector<std::pair<std::string, Mesh>> cases = {
      {"no area", with({{0, 0, 1}, {2, 2, 2}, {0, 1, 8}}, {half})},
      {"twice", with({t0}, {})},
      {"all twice", with(all, {})},
      {"twice, opposite", with({reversed[0]}, {})},
      {"all twice, opposite", with(reversed, {})},
      {"T-junction", split}};
  for (const LightKind light : kLights) {
    ShadowScene plain = scene_under_light(light, 2.0, 0.3);
    plain.add(box);
    for (const auto& [what, mesh] : cases) {
      ShadowScene made = plain;
      made.scene.meshes.back() = mesh;
      const std::vector<Vector3d> points = points_on_line(-1.5, 1.5, 400);
      EXPECT_GT(expect_true(made, points, what), 390) << what;
    }
  }
}

std::vector<Vector3d> floor_points(int n, double half) {
  std::vector<Vector3d> points;
  for (int row = 0; row < n; ++row) {
    for (int col = 0; col < n; ++col) {
      points.emplace_back(half * (2.0 * (col + 0.5) / n - 1.0),
                          half * (2.0 * (row + 0.5) / n - 1.0), 0.0);
    }
  }
  return points;
}

/// Beside a ball that hides a part of the light, as its fine mesh says, values are traced.
TEST(SoftShadowExtremes, AllThatABallHidesIsTraced) {
  for (const LightKind light : kLights) {
    ShadowScene ball = scene_under_light(light, 2.0, 0.3);
    ball.scene.spheres.push_back(
        {.centre = {0.1, 0.05, 1.0}, .radius_mm = 0.35, .material = kDark});
    ShadowScene facets = scene_under_light(light, 2.0, 0.3);
    facets.scene.meshes.push_back(make_sphere({0.1, 0.05, 1.0}, 0.35, 4, kDark));
    const std::vector<Vector3d> points = floor_points(24, 2.5);
    const test::ShadowValues traced =
        test::shadow_values(ball.scene, points, {.max_error = 0.2});
    const test::ShadowValues fine = test::shadow_values(facets.scene, points);
    int n_hidden = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (fine.shadows[i].visibility < 0.999F) {
        ++n_hidden;
        EXPECT_EQ(traced.shadows[i].kind, ShadowKind::traced) << points[i].transpose();
      }
    }
    EXPECT_GT(n_hidden, 50);
    EXPECT_LT(traced.counts.by_kind[static_cast<std::size_t>(ShadowKind::traced)], 400);
  }
}

/// A tilted block through the light: its section there is a border that no edge draws.
TEST(SoftShadowExtremes, WhatPassesThroughTheLightIsTraced) {
  for (const LightKind light : kLights) {
    ShadowScene made = scene_under_light(light, 2.0, 0.3);
    made.add(turned(make_box({-0.12, -0.08, -0.3}, {0.12, 0.08, 0.3}, kDark), 0.5, {1, 0.3, 0},
                    {0.05, -0.04, 2.0}));
    const std::vector<Vector3d> points = floor_points(12, 4.0);
    EXPECT_EQ(expect_true(made, points, "through the light", {.max_error = 0.1}), 0);
  }
}

/// A sheet that begins beside the light, before it, and goes on behind and over it: only what is
/// before the light's plane hides.
TEST(SoftShadowExtremes, WhatGoesPastTheLightHidesBeforeItAlone) {
  for (const LightKind light : kLights) {
    ShadowScene made = scene_under_light(light, 2.0, 0.3);
    made.add(make_quad({1.1, -0.2, 1.6}, {1.1, 0.15, 1.6}, {-0.9, 0.15, 3.0}, {-0.9, -0.2, 3.0},
                       kDark));
    const std::vector<Vector3d> points = floor_points(30, 6.0);
    // One cell: every edge is looked at for every point.
    EXPECT_EQ(expect_true(made, points, "past the light", {.grid = 1}), 900);
  }
}

TEST(SoftShadowExtremes, WhatIsTracedSaysSo) {
  for (const LightKind light : kLights) {
    ShadowScene box = scene_under_light(light, 2.0, 0.3);
    box.add(tilted_box());
    const SoftShadowOptions options{.most_edges = 0, .strata = 32};
    ShadowScene cut = scene_under_light(light, 2.0, 0.3);
    cut.add(make_box({-0.1, -0.1, 1.5}, {0.1, 0.1, 2.5}, kDark));
    const std::vector<Vector3d> points = points_on_line(-1.0, 1.0, 50);
    for (const ShadowScene* made : {&box, &cut}) {
      const test::ShadowValues values = test::shadow_values(made->scene, points, options);
      int n_traced = 0;
      for (std::size_t i = 0; i < points.size(); ++i) {
        const LightShadow& shadow = values.shadows[i];
        n_traced += shadow.kind == ShadowKind::traced ? 1 : 0;
        // Each border crosses about 4 strata in a row of them, half of each in doubt.
        EXPECT_NEAR(shadow.visibility, made->truth(points[i]), 2.0 / options.strata);
      }
      EXPECT_GT(n_traced, 20);
    }
    // A disk in the way, as a fine polygon's limit: level with the light, seen from below its middle.
    ShadowScene round = scene_under_light(light, 2.0, 0.3);
    round.scene.disks.push_back({.centre = {0, 0, 1}, .radius_mm = 0.1, .material = kDark});
    if (light == LightKind::disk) {
      const LightShadow shadow =
          test::shadow_values(round.scene, {Vector3d::Zero()}, options).shadows[0];
      EXPECT_EQ(shadow.kind, ShadowKind::traced);
      EXPECT_NEAR(shadow.visibility, 1.0 - 4.0 / 9.0, 1.0 / options.strata);
    }
    ShadowScene ball = scene_under_light(light, 2.0, 0.3);
    ball.scene.spheres.push_back({.centre = {0, 0, 1}, .radius_mm = 0.5, .material = kDark});
    const LightShadow shadow =
        test::shadow_values(ball.scene, {Vector3d::Zero()}, options).shadows[0];
    EXPECT_EQ(shadow.kind, ShadowKind::traced);
    EXPECT_EQ(shadow.visibility, 0.0F);
  }
}

/// Only in the many-scenes run: a million triangles.
TEST(SoftShadowExtremes, AMillionTriangles) {
  if (testing::number_from("HAARLIGHT_SOFT_SHADOW_SCENES", 0) < 10000) {
    GTEST_SKIP() << "only with HAARLIGHT_SOFT_SHADOW_SCENES=10000";
  }
  ShadowScene made = scene_under_light(LightKind::disk, 2.0, 0.3);
  made.scene.meshes.push_back(make_sphere({0, 0, 1}, 0.4, 8, kDark));
  made.scene.meshes.push_back(make_sphere({0.5, 0, 1}, 0.4, 8, kDark));
  EXPECT_GT(made.scene.meshes[0].triangles.size(), 500000U);
  const std::vector<Vector3d> points = points_on_line(-1.5, 1.5, 100);
  const test::ShadowValues values = test::shadow_values(made.scene, points);
  for (const LightShadow& shadow : values.shadows) {
    EXPECT_TRUE(shadow.visibility >= 0.0F && shadow.visibility <= 1.0F);
  }
  EXPECT_EQ(values.shadows[50].visibility, 0.0F);  // below the first sphere's middle
}

/// Asked for several sets of points in turn, against each alone.
void expect_the_same_as_alone(const Scene& scene,
                              const std::vector<std::vector<Vector3d>>& sets) {
  const RayCaster caster(scene);
  const OccluderEdges edges = occluder_edges(scene.meshes);
  std::vector<FlatLight> lights = flat_lights(scene, LightShape::own, "the test");
  SoftShadow soft(scene, edges, caster, std::move(lights.at(0)), {}, "the test");
  for (std::size_t set = 0; set < sets.size(); ++set) {
    std::vector<LightShadow> shadows(sets[set].size());
    soft.evaluate(sets[set], shadows);
    const test::ShadowValues alone = test::shadow_values(scene, sets[set]);
    for (std::size_t i = 0; i < shadows.size(); ++i) {
      ASSERT_EQ(shadows[i].visibility, alone.shadows[i].visibility) << set << ", " << i;
      ASSERT_EQ(shadows[i].kind, alone.shadows[i].kind) << set << ", " << i;
    }
    EXPECT_EQ(soft.counts().by_kind, alone.counts.by_kind);
    EXPECT_EQ(soft.counts().n_penumbra, alone.counts.n_penumbra);
    EXPECT_EQ(soft.counts().traced.strata, alone.counts.traced.strata);
  }
}

/// In turn: some, others beyond these, some within both, and higher up than all.
std::vector<std::vector<Vector3d>> sets_of_points() {
  std::vector<std::vector<Vector3d>> sets = {
      points_on_line(-0.2, 0.3, 300), points_on_line(0.2, 1.5, 300),
      points_on_line(-1.6, -0.1, 300), points_on_line(-0.1, 0.5, 300)};
  std::vector<Vector3d> high = points_on_line(-0.9, 0.9, 300);
  std::vector<Vector3d> low = high;
  for (std::size_t i = 0; i < high.size(); ++i) {
    high[i].z() = 0.4;
    low[i].z() = -1.5;
  }
  sets.push_back(high);
  sets.push_back(low);
  return sets;
}

TEST(SoftShadowInTurn, PointsAreTheSameAsAlone) {
  for (const LightKind light : kLights) {
    ShadowScene made = scene_under_light(light, 2.0, 0.2);
    made.add(tilted_box());
    expect_the_same_as_alone(made.scene, sets_of_points());
  }
}

TEST(SoftShadowInTurn, CurvedSurfacesAreTracedForTheSamePoints) {
  ShadowScene made = scene_under_light(LightKind::disk, 2.0, 0.2);
  made.add(tilted_box());
  made.scene.spheres.push_back(
      {.centre = {0.5, 0.0, 0.9}, .radius_mm = 0.1, .material = kDark});
  expect_the_same_as_alone(made.scene, sets_of_points());
}

}  // namespace
}  // namespace haarlight::render
