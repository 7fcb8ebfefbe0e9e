// SPDX-License-Identifier: Apache-2.0
/// @file
/// Sides of patches that lie partly within a body, light that is linear in an element, and patches that
/// are shown in parts.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <optional>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "render/radiosity/element_slopes.h"
#include "render/radiosity/elements.h"
#include "render/radiosity/patch_light.h"
#include "render/radiosity/patch_rays.h"
#include "render/radiosity/vertex_light.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

TEST(SeenWithin, IsWhatPointsThatHaveNothingInCommonSee) {
  using Points = std::vector<SeenFromPoint>;
  EXPECT_EQ(seen_within({}), std::nullopt);
  EXPECT_EQ(seen_within(Points{{1, 2}, {2, 3}, {3, 4}}), std::nullopt) << "all are joined";
  EXPECT_EQ(seen_within(Points{{7, 5}, {1, 2}, {2, 3}, {5, 6}, {3, 9}, {3}}),
            (std::vector<Seen>{5, 6, 7}))
      << "sees less";
  EXPECT_EQ(seen_within(Points{{std::nullopt}, {1, 2}, {2, 3}, {std::nullopt}}),
            (std::vector<Seen>{1, 2, 3}))
      << "does not see out";
  EXPECT_EQ(seen_within(Points{{1, 2}, {3}, {2}, {1}}), std::nullopt) << "one point is chance";
  EXPECT_EQ(seen_within(Points{{5}, {5}, {1, 2}, {2}, {4}, {4}}), (std::vector<Seen>{4, 5}))
      << "two bodies";
}

/// A white floor of 200 mm under a light from straight above, and what stands on it.
Scene floor_and(std::vector<Mesh> others) {
  Scene scene;
  scene.materials = {{.kd = Vector3d::Constant(0.5)}, {.kd = Vector3d::Zero()}};
  scene.meshes = {make_quad({-100, -100, 0}, {100, -100, 0}, {100, 100, 0}, {-100, 100, 0}, 0)};
  for (Mesh& mesh : others) {
    scene.meshes.push_back(std::move(mesh));
  }
  scene.directional_lights = {{.direction = {0, 0, -1}, .irradiance = Vector3d::Constant(8.0)}};
  return scene;
}

/// A block turned by 0.3 rad whose sides have no bottom and face inwards, as those of cornell.toml do.
std::vector<Mesh> open_block(int material) {
  const auto at = [](double x, double y, double z) -> Vector3d {
    return {std::cos(0.3) * x - std::sin(0.3) * y + 7.0,
            std::sin(0.3) * x + std::cos(0.3) * y - 5.0, z};
  };
  constexpr double kX = 37.0;
  constexpr double kY = 23.0;
  constexpr double kZ = 40.0;
  return {
      make_quad(at(-kX, -kY, kZ), at(kX, -kY, kZ), at(kX, kY, kZ), at(-kX, kY, kZ), material),
      make_quad(at(-kX, -kY, 0), at(-kX, -kY, kZ), at(kX, -kY, kZ), at(kX, -kY, 0), material),
      make_quad(at(kX, -kY, 0), at(kX, -kY, kZ), at(kX, kY, kZ), at(kX, kY, 0), material),
      make_quad(at(kX, kY, 0), at(kX, kY, kZ), at(-kX, kY, kZ), at(-kX, kY, 0), material),
      make_quad(at(-kX, kY, 0), at(-kX, kY, kZ), at(-kX, -kY, kZ), at(-kX, -kY, 0), material)};
}

struct FloorRadiosity {
  std::size_t n_between = 0;  ///< fronts of the floor's patches that are neither lit nor dark
  double most = 0.0;
};

FloorRadiosity floor_of(const PatchLight& light) {
  FloorRadiosity found;
  for (std::size_t patch = 0; patch < light.patches().size(); ++patch) {
    if (light.patches().triangle_of(patch).surface == 0) {
      const double value = light.radiosity()[2 * patch].x();
      found.most = std::max(found.most, value);
      found.n_between += value > 0.03 * 4.0 && value < 0.95 * 4.0 ? 1 : 0;
    }
  }
  return found;
}

/// The block is black, so that each point of the floor beside it reflects 8 x 0.5 and nothing else; a patch
/// that is partly below it has to, too. 5 %, and 3 % of what is not below it: of so little no probe may be.
TEST(Elements, WhatABlockCoversDoesNotDarkenTheFloorBesideIt) {
  for (const bool is_open : {true, false}) {
    const Scene scene = floor_and(
        is_open ? open_block(1) : std::vector{make_box({-31, -27, -5}, {43, 19, 40}, 1)});
    const RayCaster caster(scene);
    const PatchLight light(scene, caster, nullptr, {.patches = 600, .rays = 256});
    EXPECT_GT(light.radiosity().size(), 2 * light.patches().size()) << is_open;
    const FloorRadiosity floor = floor_of(light);
    EXPECT_NEAR(floor.most, 4.0, 1e-3);
    EXPECT_EQ(floor.n_between, 0U) << is_open;
  }
}

/// A lamp in a closed box lights the box's part of the floor, and none of it gets out.
TEST(Elements, LightWithinABodyStaysThere) {
  Scene scene = floor_and({make_box({-31, -27, -5}, {43, 19, 40}, 0)});
  scene.directional_lights.clear();
  scene.point_lights = {{.position = {5, -3, 20}, .intensity = Vector3d::Constant(1e3)}};
  const RayCaster caster(scene);
  const PatchLight light(scene, caster, nullptr, {.patches = 600, .rays = 256});
  const std::size_t n_sides = 2 * light.patches().size();
  ASSERT_GT(light.radiosity().size(), n_sides);
  for (std::size_t i = n_sides; i < light.radiosity().size(); ++i) {
    EXPECT_GT(light.radiosity()[i].x(), 0.01) << i;
  }
  // Around the block's foot, outside.
  for (const Vector2d& uv : {Vector2d(0.2, 0.01), Vector2d(0.9, 0.02), Vector2d(0.7, 0.2)}) {
    const Vector3d found = light.irradiance({.u = static_cast<float>(uv.x()),
                                             .v = static_cast<float>(uv.y()),
                                             .mesh = 0,
                                             .triangle = 0},
                                            true);
    EXPECT_LT(found.x(), 1e-3) << uv.transpose();
  }
}

/// An open sheet is legitimately seen from behind: nothing is within.
TEST(Elements, ASheetAboveAFloorCoversNothing) {
  const Scene scene =
      floor_and({make_quad({-40, -40, 30}, {40, -40, 30}, {40, 40, 30}, {-40, 40, 30}, 0),
                 make_quad({-90, 10, 0}, {-90, 90, 0}, {-90, 90, 60}, {-90, 10, 60}, 0)});
  const RayCaster caster(scene);
  const Patches patches(scene, 600);
  const PatchRays rays(scene, caster, nullptr, patches, 64, 0);
  const Elements elements = rays.elements();
  EXPECT_EQ(elements.size(), elements.n_sides());
}

Patches patches_of_triangle(Scene& scene, std::size_t n) {
  scene.materials = {{}};
  Mesh mesh = make_quad({0, 0, 0}, {60, 0, 0}, {60, 40, 0}, {0, 40, 0}, 0);
  mesh.triangles.resize(1);
  scene.meshes = {mesh};
  return {scene, n};
}

TEST(ElementSlopes, ALinearFunctionIsFoundAtEachPoint) {
  Scene scene;
  const Patches patches = patches_of_triangle(scene, 100);
  const Elements elements(2 * patches.size());
  const auto linear = [](const Vector2d& uv) -> Vector3d {
    return {3.0 + uv.x() - 2.0 * uv.y(), 5.0 - 4.0 * uv.x(), 1.0};
  };
  std::vector<Vector3d> radiosity(elements.size());
  for (std::size_t side = 0; side < elements.size(); ++side) {
    const Vector3d middle = linear(patches.uv_in(side / 2, {4.0 / 9.0, 0.5}));
    radiosity[side] = side % 2 == 0 ? middle : 2.0 * middle;
  }
  const ElementSlopes slopes(patches, elements, radiosity);
  for (double u = 0.002; u < 0.99; u += 0.017) {
    const Vector2d uv(u, 0.83 * (1.0 - u));
    const PatchPoint at = Patches::find_in(patches.triangles()[0], uv);
    EXPECT_NEAR((slopes.radiosity(2 * at.patch, at) - linear(uv)).norm(), 0.0, 1e-5);
    EXPECT_NEAR((slopes.radiosity(2 * at.patch + 1, at) - 2.0 * linear(uv)).norm(), 0.0, 1e-5);
  }
}

TEST(ElementSlopes, LeaveNothingBelowZeroAndOnePatchFlat) {
  Scene scene;
  const Patches patches = patches_of_triangle(scene, 100);
  const Elements elements(2 * patches.size());
  std::vector<Vector3d> radiosity(elements.size());
  for (std::size_t side = 0; side < elements.size(); ++side) {
    const double u = patches.uv_in(side / 2, {4.0 / 9.0, 0.5}).x();
    radiosity[side] = Vector3d::Constant(u > 0.4 ? 1e6 : 1.0);
  }
  const ElementSlopes slopes(patches, elements, radiosity);
  for (double u = 0.0; u < 1.0; u += 0.013) {
    const PatchPoint at = Patches::find_in(patches.triangles()[0], {u, 0.5 * (1.0 - u)});
    EXPECT_GE(slopes.radiosity(2 * at.patch, at).minCoeff(), -1e-6 * 1e6) << u;
  }
  Scene single;
  const Patches one = patches_of_triangle(single, 1);
  const std::vector<Vector3d> value(2, Vector3d::Ones());
  const PatchPoint corner = Patches::find_in(one.triangles()[0], {0, 0});
  EXPECT_EQ(ElementSlopes(one, Elements(2), value).radiosity(0, corner), Vector3d::Ones());
}

/// The largest error of what is shown of a function of (u, v) on a triangle of 100 patches.
template <class Function>
double shown_error(const Function& function, std::size_t& n_faces) {
  Scene scene;
  const Patches patches = patches_of_triangle(scene, 100);
  const VertexLight shown(
      scene, patches, std::vector<std::uint8_t>(2 * patches.size(), 1),
      [&](std::size_t, const CutTriangle&, bool is_front, const Vector2d& uv) -> Vector3d {
        return (is_front ? 1.0 : 2.0) * Vector3d::Constant(function(uv));
      });
  n_faces = shown.n_faces();
  EXPECT_GE(n_faces, 2 * patches.size());
  double most = 0.0;
  for (double u = 0.037; u < 0.9; u += 0.0117) {
    for (double v = 0.031; u + v < 0.96; v += 0.0133) {
      const PatchPoint at = Patches::find_in(patches.triangles()[0], {u, v});
      const double truth = function(Vector2d(u, v));
      most = std::max({most, std::abs(shown.irradiance(at, true).x() - truth),
                       std::abs(0.5 * shown.irradiance(at, false).x() - truth)});
    }
  }
  return most;
}

/// What is linear is shown as it is, but for a tenth of a patch at the triangle's edges, and in no more
/// parts than those that change much. A bend at u = 0.42, within a patch: linear in the patches alone it
/// would be 0.032 off there.
TEST(VertexLight, IsFinerWhereLightBends) {
  std::size_t n_flat = 0;
  std::size_t n_bent = 0;
  EXPECT_LT(shown_error([](const Vector2d& uv) { return 9.0 + uv.x(); }, n_flat), 0.02);
  EXPECT_EQ(n_flat, 200U);
  const double bent =
      shown_error([](const Vector2d& uv) { return 0.2 + std::abs(uv.x() - 0.42); }, n_bent);
  std::printf("%zu faces, off by %.4f\n", n_bent, bent);
  EXPECT_LT(bent, 0.02);
  EXPECT_GT(n_bent, n_flat);
}

}  // namespace
}  // namespace haarlight::render
