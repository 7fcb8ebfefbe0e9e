// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/flat_light.h"

#include <functional>
#include <numbers>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "tests/render/soft_shadow/shadow_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using test::kBright;
using test::LightKind;

Scene dark_scene() {
  Scene scene = test::scene_under_light(LightKind::disk, 2.0, 0.5).scene;
  scene.disks.clear();
  return scene;
}

Scene with_mesh(std::vector<Vector3d> vertices, std::vector<Eigen::Vector3i> triangles) {
  Scene scene = dark_scene();
  scene.meshes.push_back({.name = "lamp",
                          .vertices = std::move(vertices),
                          .triangles = std::move(triangles),
                          .material = kBright});
  return scene;
}

const std::vector<Vector3d> kCorners = {{0, 0, 2}, {0, 3, 2}, {2, 3, 2}, {2, 0, 2}};

TEST(FlatLight, QuadsOfAnyFirstCornerShineWhereTheirFrontIs) {
  for (const bool is_up : {false, true}) {
    for (int first = 0; first < 4; ++first) {
      std::vector<int> c = {first, (first + 1) % 4, (first + 2) % 4, (first + 3) % 4};
      if (is_up) {
        std::swap(c[1], c[3]);
      }
      const Scene scene = with_mesh(kCorners, {{c[0], c[1], c[2]}, {c[0], c[2], c[3]}});
      const FlatLight own = flat_lights(scene, LightShape::own, "the test").at(0);
      EXPECT_LT((own.centre - Vector3d(1.0, 1.5, 2.0)).norm(), 1e-14);
      EXPECT_NEAR(own.light_from_world(2, 2), is_up ? 1.0 : -1.0, 1e-15);
      EXPECT_NEAR(own.light_from_world.determinant(), 1.0, 1e-14);
      ASSERT_EQ(own.corners.size(), 4U);
      // Six roundings of the area; positive just for counter-clockwise corners.
      EXPECT_NEAR(own.area() * own.radius_mm * own.radius_mm, 6.0, 1e-14);
      const FlatLight disk = flat_lights(scene, LightShape::disk, "the test").at(0);
      EXPECT_TRUE(disk.is_disk());
      EXPECT_NEAR(disk.area() * disk.radius_mm * disk.radius_mm, 6.0, 1e-14);
      EXPECT_NEAR(std::numbers::pi * disk.radius_mm * disk.radius_mm, 6.0, 1e-14);
    }
  }
}

TEST(FlatLight, LedsAreSquaresOfEitherHandedness) {
  for (const double sign : {1.0, -1.0}) {
    Scene scene = dark_scene();
    scene.lights.push_back({.centre = {1, 2, 3},
                            .u = sign * Vector3d::UnitX(),
                            .emits = -Vector3d::UnitZ(),
                            .width_mm = 2.0,
                            .height_mm = 3.0});
    const FlatLight own = flat_lights(scene, LightShape::own, "the test").at(0);
    EXPECT_EQ(own.surface, FlatLight::kNoSurface);
    EXPECT_LT((own.centre - Vector3d(1, 2, 3)).norm(), 1e-14);
    EXPECT_NEAR(own.area() * own.radius_mm * own.radius_mm, 6.0, 1e-14);
    const FlatLight disk = flat_lights(scene, LightShape::disk, "the test").at(0);
    EXPECT_NEAR(disk.area() * disk.radius_mm * disk.radius_mm, 6.0, 1e-14);
  }
}

TEST(FlatLight, WhatIsNoFlatLightIsNamed) {
  const auto refusal = [](const Scene& scene) -> std::string {
    try {
      static_cast<void>(flat_lights(scene, LightShape::own, "the test"));
    } catch (const Error& error) {
      return error.problem();
    }
    return "";
  };
  const auto expect_named = [&](const Scene& scene, const std::string& name) {
    EXPECT_NE(refusal(scene).find(name), std::string::npos) << name << ": " << refusal(scene);
  };
  Scene scene = dark_scene();
  scene.spheres.push_back({.centre = {0, 0, 1}, .radius_mm = 1.0, .material = kBright});
  expect_named(scene, "sphere 0");
  scene = dark_scene();
  scene.point_lights.emplace_back();
  expect_named(scene, "point");
  scene = dark_scene();
  scene.directional_lights.emplace_back();
  expect_named(scene, "directional");
  std::vector<Vector3d> curved = kCorners;
  curved[2].z() += 0.01;
  expect_named(with_mesh(curved, {{0, 1, 2}, {0, 2, 3}}), "mesh 0 (lamp)");
  std::vector<Vector3d> concave = kCorners;
  concave[2] = {0.5, 0.5, 2};
  expect_named(with_mesh(concave, {{0, 1, 2}, {0, 2, 3}}), "mesh 0 (lamp)");
  expect_named(dark_scene(), "nothing");
}

}  // namespace
}  // namespace haarlight::render
