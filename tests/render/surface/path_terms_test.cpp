// SPDX-License-Identifier: Apache-2.0
#include "render/surface/path_terms.h"

#include <algorithm>
#include <cstddef>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"
#include "tests/render/surface/square_camera.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

Mesh turned_inside_out(Mesh mesh) {
  for (Eigen::Vector3i& triangle : mesh.triangles) {
    std::swap(triangle[1], triangle[2]);
  }
  return mesh;
}

/// Both in one mesh.
Mesh joined(Mesh mesh, const Mesh& added) {
  const auto shift = static_cast<int>(mesh.vertices.size());
  mesh.vertices.insert(mesh.vertices.end(), added.vertices.begin(), added.vertices.end());
  for (const Eigen::Vector3i& triangle : added.triangles) {
    mesh.triangles.emplace_back(triangle.array() + shift);
  }
  return mesh;
}

/// A ring of square section about the z axis: closed, connected, not convex.
Mesh make_ring() {
  constexpr int kAround = 12;
  Mesh mesh;
  for (int i = 0; i < kAround; ++i) {
    const Eigen::AngleAxisd turn(2.0 * std::numbers::pi * i / kAround, Vector3d::UnitZ());
    for (const Vector3d& corner :
         {Vector3d(20, 0, -5), Vector3d(30, 0, -5), Vector3d(30, 0, 5), Vector3d(20, 0, 5)}) {
      mesh.vertices.emplace_back(turn * corner);
    }
  }
  for (int i = 0; i < kAround; ++i) {
    const int j = (i + 1) % kAround;
    for (int k = 0; k < 4; ++k) {
      const int l = (k + 1) % 4;
      mesh.triangles.emplace_back(4 * i + k, 4 * j + k, 4 * j + l);
      mesh.triangles.emplace_back(4 * i + k, 4 * j + l, 4 * i + l);
    }
  }
  return mesh;
}

TEST(PathTerms, ConvexBodiesAndFlatMeshesAreTold) {
  const Mesh cube = make_box({-10, -20, 0}, {30, 20, 10}, 0);
  const Mesh ball = make_sphere({1e4, 0, 0}, 3.0, 3, 0);
  const Mesh quad = make_quad({0, 0, 0}, {10, 0, 3}, {10, 10, 3}, {0, 10, 0}, 0);
  EXPECT_TRUE(is_convex_or_flat(cube));
  EXPECT_TRUE(is_convex_or_flat(ball));
  EXPECT_TRUE(is_convex_or_flat(quad));

  Mesh open = cube;
  open.triangles.pop_back();
  EXPECT_FALSE(is_convex_or_flat(open));
  EXPECT_FALSE(is_convex_or_flat(turned_inside_out(cube)));
  EXPECT_FALSE(is_convex_or_flat(make_ring()));
  EXPECT_FALSE(is_convex_or_flat(turned_inside_out(make_ring())));
  EXPECT_FALSE(is_convex_or_flat(joined(cube, make_box({100, 0, 0}, {110, 10, 10}, 0))));
  EXPECT_FALSE(is_convex_or_flat(joined(cube, quad)));
  EXPECT_FALSE(is_convex_or_flat({}));
  Mesh dented = cube;  // one corner pushed in
  dented.vertices.front() += Vector3d(15, 15, 4);
  EXPECT_FALSE(is_convex_or_flat(dented));
  Mesh bent = quad;
  bent.vertices.back().z() += 1e-3;
  EXPECT_FALSE(is_convex_or_flat(bent));
}

TEST(PathTerms, ASceneIsAloneWithOneSuchSurfaceThatLetsNoLightThrough) {
  Scene scene;
  scene.materials = {{.name = "matte"}, {.name = "glass", .bsdf = BsdfKind::dielectric}};
  scene.spheres = {{.radius_mm = 10.0}};
  EXPECT_TRUE(is_alone_and_convex(scene));
  scene.spheres.front().material = 1;
  EXPECT_FALSE(is_alone_and_convex(scene));
  scene.spheres.front().material = 0;
  scene.disks = {{.radius_mm = 1.0}};
  EXPECT_FALSE(is_alone_and_convex(scene));
  scene.spheres.clear();
  EXPECT_TRUE(is_alone_and_convex(scene));
}

struct Rendered {
  std::vector<float> picture;
  std::uint64_t n_rays = 0;
  PathTerms terms;
};
Rendered render(const Scene& scene, const PathOptions& options,
                const Environment* environment) {
  const RayCaster caster(scene);
  const CameraModel model = testing::square_camera({60, -90, 120}, {0, 0, 5}, 40.0, 32);
  const PathIntegrator integrator(scene, caster, environment, model, options);
  Film film(model.width, model.height, surface_layers(options.has_features));
  const RunResult result = run(integrator, {.samples = 8}, film);
  const Image<float> mean = film.mean(0);
  return {.picture = {mean.pixels().begin(), mean.pixels().end()},
          .n_rays = result.n_rays,
          .terms = integrator.terms()};
}

TEST(PathTerms, WhatASceneDoesNotRequireChangesNoBit) {
  Scene ball;
  ball.materials = {{.name = "plastic", .ks = 0.2, .exponent = 20.0}};
  ball.meshes = {make_sphere({0, 0, 0}, 30.0, 3, 0)};
  ball.directional_lights = {{.direction = Vector3d(-0.6, 0.0, -0.8)}};
  Scene floor;
  floor.materials = {{.name = "matte"}};
  floor.meshes = {make_quad({-50, -50, 0}, {50, -50, 0}, {50, 50, 0}, {-50, 50, 0}, 0)};
  floor.environment = EnvironmentSource{};
  Scene lamp = floor;
  lamp.environment.reset();
  lamp.materials.push_back(
      {.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d::Constant(3.0)});
  lamp.spheres = {{.centre = Vector3d(0, 0, 40), .radius_mm = 10.0, .material = 1}};
  Image<float> even(4, 8, 3);
  std::ranges::fill(even.pixels(), 0.7F);
  const Environment sky = Environment::from_picture(even, "even");
  struct Case {
    std::string name;
    const Scene* scene;
    const Environment* environment;
    bool is_alone;
  };
  for (const Case& c : {Case{"ball", &ball, nullptr, true}, Case{"floor", &floor, &sky, true},
                        Case{"lamp", &lamp, nullptr, false}}) {
    const Rendered plain = render(*c.scene, {}, c.environment);
    EXPECT_GT(*std::ranges::max_element(plain.picture), 0.0F) << c.name;
    EXPECT_EQ(plain.terms.has(PathTerm::self_rays), !c.is_alone) << c.name;
    for (std::size_t t = 0; t < kPathTermWords.size(); ++t) {
      PathOptions options;
      options.also.add(static_cast<PathTerm>(t));
      const Rendered all_the_same = render(*c.scene, options, c.environment);
      EXPECT_EQ(plain.picture, all_the_same.picture) << c.name << ' ' << kPathTermWords[t];
      if (c.is_alone && static_cast<PathTerm>(t) == PathTerm::self_rays) {
        EXPECT_GT(all_the_same.n_rays, plain.n_rays) << c.name;
      }
    }
  }
}

TEST(PathTerms, ACropIsThatPartOfThePicture) {
  Scene scene;
  scene.materials = {{.name = "matte"}};
  scene.spheres = {{.radius_mm = 30.0}};
  scene.point_lights = {
      {.position = Vector3d(100, -100, 200), .intensity = Vector3d::Constant(1e5)}};
  const RayCaster caster(scene);
  const CameraModel model = testing::square_camera({60, -90, 120}, {0, 0, 5}, 60.0, 70);
  const auto picture = [&](int width, int height, const PathOptions& options) {
    const PathIntegrator integrator(scene, caster, nullptr, model, options);
    Film film(width, height, surface_layers(false));
    (void)run(integrator, {.samples = 4}, film);
    return film.mean(0);
  };
  const Image<float> whole = picture(70, 70, {});
  PathOptions options;
  options.first_x = 21;
  options.first_y = 33;
  const Image<float> crop = picture(40, 37, options);
  for (int y = 0; y < 37; ++y) {
    for (int x = 0; x < 40; ++x) {
      EXPECT_EQ(crop(y, x), whole(y + 33, x + 21)) << x << ' ' << y;
    }
  }
}

}  // namespace
}  // namespace haarlight::render
