// SPDX-License-Identifier: Apache-2.0
/// @file
/// Instances beside the same scene with each of them expanded to a mesh of its own.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/light/scene_lights.h"
#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"
#include "tests/render/surface/square_camera.h"

namespace haarlight::render {
namespace {

using Eigen::Affine3d;
using Eigen::Matrix3d;
using Eigen::Vector3d;

double uniform(std::uint64_t a, std::uint64_t b) { return uniform_unit(hash_key(91, a, b)); }

Vector3d random_vector(std::uint64_t a, std::uint64_t b, double size) {
  return size * Vector3d(uniform(a, 3 * b) - 0.5, uniform(a, 3 * b + 1) - 0.5,
                         uniform(a, 3 * b + 2) - 0.5);
}

Instance placed(int mesh, const Matrix3d& linear, const Vector3d& to, int material = -1) {
  Instance instance{.mesh = mesh, .material = material};
  instance.world_from_mesh.linear() = linear;
  instance.world_from_mesh.translation() = to;
  return instance;
}

Matrix3d turn(double angle, const Vector3d& axis) {
  return Eigen::AngleAxisd(angle, axis.normalized()).toRotationMatrix();
}

/// A floor, a ball with normals, a box and a sheet with texture coordinates; of all but the floor
/// instances that are turned, scaled, stretched, sheared and mirrored. One is a lamp.
Scene many_ways() {
  Scene scene;
  scene.materials = {{.name = "floor", .kd = Vector3d::Constant(0.6)},
                     {.name = "red", .kd = Vector3d(0.7, 0.2, 0.1)},
                     {.name = "tiles", .kd_texture = {.file = "made.png"}},
                     {.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d(9, 8, 7)}};
  scene.meshes.push_back(
      make_quad({-300, -300, 0}, {300, -300, 0}, {300, 300, 0}, {-300, 300, 0}, 0));
  scene.meshes.push_back(make_sphere({0, 0, 40}, 30.0, 3, 1));
  scene.meshes.push_back(make_box({-150, -20, 5}, {-110, 20, 45}, 1));
  scene.meshes.push_back(
      make_quad({100, -40, 20}, {160, -40, 20}, {160, 40, 60}, {100, 40, 60}, 2));
  scene.spheres.push_back({.centre = {0, -150, 30}, .radius_mm = 25.0, .material = 1});
  scene.disks.push_back({.centre = {0, 150, 10}, .radius_mm = 25.0, .material = 1});
  Matrix3d sheared = Matrix3d::Identity();
  sheared(0, 1) = 0.5;
  scene.instances = {placed(1, turn(0.7, {1, 2, 3}), {120, 120, 30}),
                     placed(1, Vector3d(1.5, 0.7, 1.0).asDiagonal(), {-120, 130, 10}),
                     placed(2, turn(2.1, {0, 1, 1}) * 0.5, {60, -130, 40}, 0),
                     placed(2, Vector3d(-1, 1, 1).asDiagonal(), {0, 90, 0}),
                     placed(2, sheared, {40, -190, 3}),
                     placed(3, turn(1.0, {0, 0, 1}), {-90, -160, 0}),
                     placed(3, turn(3.1, {1, 0.1, 0}) * 2.0, {-230, 0, 300}, 3)};
  return scene;
}

/// Where a surface is in the expanded scene.
std::uint32_t expanded_number(const Scene& scene, std::uint32_t surface) {
  const auto n_meshes = static_cast<std::uint32_t>(scene.meshes.size());
  const auto n_round = static_cast<std::uint32_t>(scene.spheres.size() + scene.disks.size());
  const auto n_instances = static_cast<std::uint32_t>(scene.instances.size());
  if (surface < n_meshes) {
    return surface;
  }
  return surface < n_meshes + n_round ? surface + n_instances : surface - n_round;
}

std::vector<Ray> random_rays(std::size_t n) {
  std::vector<Ray> rays;
  for (std::uint64_t i = 0; i < n; ++i) {
    const Vector3d origin = random_vector(1, i, 700.0) + Vector3d(0, 0, 400);
    rays.push_back(
        {.origin = origin,
         .direction = (random_vector(2, i, 500.0) + Vector3d(0, 0, 40) - origin).normalized()});
  }
  return rays;
}

TEST(Instances, AreHitWhereTheExpandedMeshesAre) {
  const Scene scene = many_ways();
  const Scene expanded = with_instances_expanded(scene, "made");
  ASSERT_TRUE(expanded.instances.empty());
  ASSERT_EQ(expanded.meshes.size(), 11U);
  const RayCaster caster(scene);
  const RayCaster truth(expanded);
  const std::vector<Ray> rays = random_rays(20000);
  std::vector<int> n_hits(scene.meshes.size() + 2 + scene.instances.size(), 0);
  int n_other = 0;
  for (const Ray& ray : rays) {
    const RawHit raw = caster.intersect(ray);
    const RawHit raw_truth = truth.intersect(ray);
    // Which of two surfaces at an edge is met is decided in single precision.
    if (raw.is_hit() != raw_truth.is_hit() ||
        (raw.is_hit() && (expanded_number(scene, raw.mesh) != raw_truth.mesh ||
                          raw.triangle != raw_truth.triangle))) {
      ++n_other;
      continue;
    }
    if (!raw.is_hit()) {
      continue;
    }
    ++n_hits[raw.mesh];
    const Hit hit = caster.surface_at(ray, raw);
    const Hit exact = truth.surface_at(ray, raw_truth);
    // Roundings of double precision at 1000 mm.
    EXPECT_LE((hit.point - exact.point).norm(), 1e-12 * 1000.0);
    EXPECT_NEAR(hit.distance_mm, exact.distance_mm, 1e-12 * 1000.0);
    EXPECT_LE((hit.flat_normal - exact.flat_normal).norm(), 1e-14);
    EXPECT_LE((hit.uv - exact.uv).norm(), 1e-13);
    EXPECT_EQ(hit.is_front, exact.is_front);
    EXPECT_EQ(hit.material, exact.material);
    // Interpolated at Embree's barycentric coordinates, 2^-24 of 1000 mm on triangles of 4 mm.
    EXPECT_LE((hit.normal - exact.normal).norm(), 1e-4);
  }
  EXPECT_LE(n_other, 20);  // one in a thousand
  EXPECT_GT(*std::ranges::min_element(n_hits), 20) << "each surface is met";
}

TEST(Instances, AnswerPacketsLikeSingleRays) {
  const Scene scene = many_ways();
  const RayCaster caster(scene);
  const std::vector<Ray> rays = random_rays(4003);  // no multiple of the packet
  std::vector<RawHit> hits(rays.size());
  std::vector<std::uint8_t> blocked(rays.size(), 9);
  caster.intersect(rays, RayOrder::scattered, hits);
  caster.are_blocked(rays, RayOrder::scattered, blocked);
  int n_other = 0;
  int n_instances = 0;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    const RawHit alone = caster.intersect(rays[i]);
    n_other += alone.mesh != hits[i].mesh || alone.triangle != hits[i].triangle ? 1 : 0;
    n_other += alone.is_hit() != (blocked[i] != 0) ? 1 : 0;
    n_instances += alone.is_hit() && alone.mesh >= scene.meshes.size() + 2 ? 1 : 0;
  }
  EXPECT_LE(n_other, 4);  // at edges
  EXPECT_GT(n_instances, 500);
}

TEST(Instances, AMirroredBodyStillFacesOutwards) {
  Scene scene;
  scene.materials.emplace_back();
  scene.meshes.push_back(make_box({-1, -1, -1}, {1, 1, 1}, 0));
  for (const Vector3d& signs : {Vector3d(-1, 1, 1), Vector3d(-1, -1, -1), Vector3d(1, -2, 1),
                                Vector3d(-1, -1, 1), Vector3d(2, 1, 3)}) {
    scene.instances = {placed(0, signs.asDiagonal(), {10, 0, 0})};
    const Scene expanded = with_instances_expanded(scene, "made");
    for (const Scene* each : {&std::as_const(scene), &expanded}) {
      const RayCaster caster(*each);
      const auto outside = caster.intersect({10.1, 0.2, 50.0}, -Vector3d::UnitZ());
      const auto inside = caster.intersect({10.1, 0.2, 0.0}, -Vector3d::UnitZ());
      ASSERT_TRUE(outside && inside);
      EXPECT_TRUE(outside->is_front) << signs.transpose();
      EXPECT_EQ(outside->flat_normal, Vector3d(0, 0, 1));
      EXPECT_FALSE(inside->is_front) << signs.transpose();
      EXPECT_EQ(inside->flat_normal, Vector3d(0, 0, 1));
    }
  }
}

Image<float> rendered(const Scene& scene) {
  const RayCaster caster(scene);
  PathOptions options;
  options.most_bounces = 3;
  const CameraModel model = testing::square_camera({0, -700, 500}, {0, 0, 20}, 70.0, 64);
  const PathIntegrator integrator(scene, caster, nullptr, model, options);
  Film film(64, 64, surface_layers(false));
  EXPECT_EQ(run(integrator, {.samples = 16}, film).samples, 16U);
  return film.mean(0);
}

TEST(Instances, ShowThePictureOfTheExpandedScene) {
  Scene scene = many_ways();
  scene.materials[2].kd_texture = {};
  const Image<float> picture = rendered(scene);
  const Image<float> expanded = rendered(with_instances_expanded(scene, "made"));
  int n_other = 0;
  double sum = 0.0;
  double truth_sum = 0.0;
  for (std::size_t i = 0; i < picture.pixels().size(); ++i) {
    const double difference = std::abs(picture.pixels()[i] - expanded.pixels()[i]);
    // Shading normals are interpolated in single precision; elsewhere a path is the same.
    n_other += difference > 1e-4 * expanded.pixels()[i] ? 1 : 0;
    sum += picture.pixels()[i];
    truth_sum += expanded.pixels()[i];
  }
  // A path that passes an edge within single precision is another one: a few in 65536.
  EXPECT_LE(n_other, 64 * 64 * 3 / 100);
  EXPECT_NEAR(sum, truth_sum, 1e-3 * truth_sum);
  EXPECT_GT(truth_sum, 0.0);
}

TEST(Instances, OfALampAreLightsOfTheirOwnArea) {
  const Scene scene = many_ways();
  const Scene expanded = with_instances_expanded(scene, "made");
  const SceneLights lights(scene, nullptr, 500.0, LightChoice::power);
  const SceneLights truth(expanded, nullptr, 500.0, LightChoice::power);
  ASSERT_EQ(lights.size(), 1U);
  ASSERT_EQ(truth.size(), 1U);
  EXPECT_DOUBLE_EQ(power(lights[0]), power(truth[0]));
  // Its sides are 2 * 60 and 2 * sqrt(80^2 + 40^2).
  EXPECT_NEAR(power(lights[0]), std::numbers::pi * 8.0 * 120.0 * 2.0 * std::sqrt(8000.0), 1e-6);
  const auto surface = static_cast<std::uint32_t>(scene.meshes.size() + 2 + 6);
  EXPECT_EQ(lights.of_surface(surface), 0U);
  EXPECT_FALSE(lights.of_surface(surface - 1));
  const LightSample sample =
      render::sample(lights[0], {-200, 0, 10}, Eigen::Vector2d(0.3, 0.6));
  const LightSample other = render::sample(truth[0], {-200, 0, 10}, Eigen::Vector2d(0.3, 0.6));
  EXPECT_EQ(sample.is_found, other.is_found);
  EXPECT_LE((sample.direction - other.direction).norm(), 1e-14);
}

TEST(Instances, TenThousandOfABallAreFoundInALittleMemory) {
  Scene scene;
  scene.materials.emplace_back();
  scene.meshes.push_back(make_sphere({0, 0, 0}, 4.0, 5, 0));
  const std::size_t n_triangles = scene.meshes[0].triangles.size();
  constexpr int kSide = 100;
  const auto centre_of = [](int i) {
    const int row = i / kSide;
    return Vector3d(10.0 * (i % kSide), 10.0 * row, 0.0);
  };
  for (int i = 1; i < kSide * kSide; ++i) {
    scene.instances.push_back(placed(0, turn(0.1 * i, {1, 1, 1}), centre_of(i)));
  }
  EXPECT_GE(n_triangles * (scene.instances.size() + 1), 80'000'000U);
  EXPECT_LE(RayCaster::bytes_needed(scene), 16'000'000U);
  EXPECT_THROW(static_cast<void>(with_instances_expanded(scene, "made")), Error);
  const RayCaster caster(scene);
  for (int i = 0; i < kSide * kSide; ++i) {
    const Vector3d centre = centre_of(i);
    const auto hit = caster.intersect(centre + Vector3d(1, 2, 30), -Vector3d::UnitZ());
    ASSERT_TRUE(hit);
    EXPECT_EQ(hit->mesh, i);  // one mesh, then the instances
    // Chords of 2^5 parts a quarter turn lie within 4 (1 - cos(pi/128)) = 1.2e-3 mm.
    EXPECT_NEAR((hit->point - centre).norm(), 4.0, 4e-3);
    EXPECT_FALSE(caster.intersect(centre + Vector3d(4.5, 4.5, 30), -Vector3d::UnitZ()));
  }
}

TEST(Instances, WithoutAnInverseAreRefused) {
  Scene scene;
  scene.materials.emplace_back();
  scene.meshes.push_back(make_box({-1, -1, -1}, {1, 1, 1}, 0));
  scene.instances = {placed(0, Vector3d(1, 0, 1).asDiagonal(), {0, 0, 0})};
  EXPECT_THROW(RayCaster{scene}, ContractViolation);
  scene.instances = {
      placed(0, Matrix3d::Identity(), {0, 0, std::numeric_limits<double>::quiet_NaN()})};
  EXPECT_THROW(RayCaster{scene}, ContractViolation);
  scene.instances = {placed(1, Matrix3d::Identity(), {0, 0, 0})};
  EXPECT_THROW(RayCaster{scene}, ContractViolation);
}

TEST(Instances, AreAppendedWithTheirMeshesAndMaterials) {
  Scene scene = many_ways();
  const Scene added = many_ways();
  append_scene(scene, added);
  ASSERT_EQ(scene.instances.size(), 14U);
  EXPECT_EQ(scene.instances[7].mesh, 5);
  EXPECT_EQ(scene.instances[7].material, -1);
  EXPECT_EQ(scene.instances[9].material, 4);
}

TEST(Instances, AreInTheHashOfAScene) {
  SceneFile file;
  file.scene = many_ways();
  file.scene.materials[2].kd_texture = {};
  const std::string hash = hash_of(file);
  file.scene.instances[0].world_from_mesh.translation().x() += 1e-9;
  EXPECT_NE(hash_of(file), hash);
  file.scene = many_ways();
  file.scene.materials[2].kd_texture = {};
  file.scene.instances[1].material = 0;
  EXPECT_NE(hash_of(file), hash);
}

}  // namespace
}  // namespace haarlight::render
