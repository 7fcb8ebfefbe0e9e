// SPDX-License-Identifier: Apache-2.0
#include "render/surface/direct_scene.h"

#include <gtest/gtest.h>

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

/// A floor, and a black lamp above it.
Scene make_floor_under_lamp() {
  Scene scene;
  scene.materials.resize(2);
  scene.materials[0].kd = Vector3d(0.0, 0.5, 0.0);
  scene.materials[1].kd.setZero();
  scene.materials[1].emits.setOnes();
  scene.meshes.push_back(make_quad({0, 0, 0}, {10, 0, 3}, {10, 10, 3}, {0, 10, 0}, 0));
  scene.disks.push_back({.centre = {0, 0, 20}, .radius_mm = 2.0, .material = 1});
  scene.spheres.push_back({.centre = {5, 0, 20}, .radius_mm = 2.0, .material = 1});
  return scene;
}

TEST(DirectScene, OneFlatReflectorHasNoIndirectLight) {
  const Scene floor = make_floor_under_lamp();
  EXPECT_FALSE(has_indirect_light(floor));
  Scene disk = floor;
  disk.meshes.clear();
  disk.disks.front().material = 0;
  EXPECT_FALSE(has_indirect_light(disk));
  Scene mirror = floor;
  mirror.materials[0].bsdf = BsdfKind::mirror;
  EXPECT_FALSE(has_indirect_light(mirror));
  Scene lamps = floor;
  lamps.meshes.clear();
  EXPECT_FALSE(has_indirect_light(lamps)) << "nothing reflects";
}

TEST(DirectScene, WhatMaySendLightOnIsTold) {
  const Scene floor = make_floor_under_lamp();
  Scene glass = floor;
  glass.materials[0].bsdf = BsdfKind::dielectric;
  EXPECT_TRUE(has_indirect_light(glass));
  Scene grey_lamp = floor;
  grey_lamp.materials[1].kd = Vector3d(0.0, 0.0, 0.01);
  EXPECT_TRUE(has_indirect_light(grey_lamp));
  Scene glossy_lamp = floor;
  glossy_lamp.materials[1].ks = 0.01;
  EXPECT_TRUE(has_indirect_light(glossy_lamp));
  Scene metal_lamp = floor;
  metal_lamp.materials[1].bsdf = BsdfKind::conductor;
  EXPECT_TRUE(has_indirect_light(metal_lamp));
  Scene ball = floor;  // from within it would light itself
  ball.meshes.clear();
  ball.spheres.front().material = 0;
  EXPECT_TRUE(has_indirect_light(ball));
  Scene box = floor;
  box.meshes.front() = make_box({0, 0, 0}, {1, 1, 1}, 0);
  EXPECT_TRUE(has_indirect_light(box));
  Scene bent = floor;
  bent.meshes.front().vertices[2].z() += 1e-6;
  EXPECT_TRUE(has_indirect_light(bent));
  Scene two = floor;
  two.meshes.push_back(make_quad({0, 0, 9}, {1, 0, 9}, {1, 1, 9}, {0, 1, 9}, 0));
  EXPECT_TRUE(has_indirect_light(two));
  Scene placed = floor;
  placed.instances.push_back({.mesh = 0, .world_from_mesh = {}, .material = -1});
  EXPECT_TRUE(has_indirect_light(placed));
}

}  // namespace
}  // namespace haarlight::render
