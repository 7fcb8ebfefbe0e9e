// SPDX-License-Identifier: Apache-2.0
/// @file
/// Bidirectional path tracing of scenes at the ends of what can be written.

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include <gtest/gtest.h>

#include "render/surface/bidirectional_integrator.h"
#include "render/surface/surface_layers.h"
#include "tests/render/surface/square_camera.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

constexpr int kSize = 16;

CameraModel camera(const Vector3d& eye, const Vector3d& target) {
  return testing::square_camera(eye, target, 20.0, kSize);
}

struct Rendered {
  Image<float> picture;
  Image<float> error;
};
Rendered render(const Scene& scene, const CameraModel& model, std::uint32_t samples,
                BidirectionalOptions options = {}) {
  options.width = kSize;
  options.height = kSize;
  options.tells_of_path_tracing = true;  // is finite, too: else the film refuses it
  const RayCaster caster(scene);
  const BidirectionalIntegrator integrator(scene, caster, nullptr, model, options);
  Film film(kSize, kSize, surface_layers(false, true, true));
  static_cast<void>(run(integrator, {.samples = samples}, film));
  return {.picture = film.mean(0), .error = film.standard_error(0)};
}

void expect_finite(const Rendered& rendered, const std::string& what) {
  for (const Image<float>* image : {&rendered.picture, &rendered.error}) {
    for (const float value : image->pixels()) {
      ASSERT_TRUE(std::isfinite(value) && value >= 0.0F) << what << ": " << value;
    }
  }
}

/// A box on a floor under lamps, all lengths times `scale`.
Scene scene_of(double scale, double radiance, const Material& material = {}) {
  Scene scene;
  scene.materials = {
      material,
      {.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d::Constant(radiance)}};
  const auto at = [scale](double x, double y, double z) -> Vector3d {
    return scale * Vector3d(x, y, z);
  };
  scene.meshes = {
      make_quad(at(-300, -300, 0), at(300, -300, 0), at(300, 300, 0), at(-300, 300, 0), 0),
      make_box(at(-60, -50, 0), at(30, 40, 80), 0),
      make_quad(at(-40, -40, 300), at(-40, 40, 300), at(40, 40, 300), at(40, -40, 300), 1)};
  scene.spheres = {{.centre = at(120, 60, 60), .radius_mm = 20 * scale, .material = 1}};
  scene.disks = {{.centre = at(-150, 100, 150),
                  .normal = Vector3d(0.6, 0.0, -0.8),
                  .radius_mm = 30 * scale,
                  .material = 1}};
  scene.point_lights = {{.position = at(0, -150, 120),
                         .intensity = Vector3d::Constant(3e3 * radiance * scale * scale)}};
  return scene;
}

TEST(BidirectionalExtremes, APictureDoesNotDependOnTheScale) {
  const Vector3d eye(90, -200, 260);
  const Rendered one = render(scene_of(1.0, 2.0), camera(eye, {0, 0, 20}), 16);
  expect_finite(one, "1");
  for (const double scale : {1e-6, 1e6}) {
    const Rendered scaled =
        render(scene_of(scale, 2.0), camera(scale * eye, scale * Vector3d(0, 0, 20)), 16);
    expect_finite(scaled, std::to_string(scale));
    // A ray that meets an edge in single precision may meet another triangle, and its light path all
    // others then.
    int n_other = 0;
    for (std::size_t i = 0; i < one.picture.pixels().size(); ++i) {
      const double a = one.picture.pixels()[i];
      n_other += std::abs(scaled.picture.pixels()[i] - a) > 1e-4 * a + 1e-6 ? 1 : 0;
    }
    EXPECT_LE(n_other, 3 * kSize * kSize / 20) << scale;
  }
}

TEST(BidirectionalExtremes, APictureIsInProportionToItsLight) {
  const CameraModel model = camera({90, -200, 260}, {0, 0, 20});
  const Rendered one = render(scene_of(1.0, 1.0), model, 8);
  for (const double radiance : {1e-20, 1e20}) {
    const Rendered lit = render(scene_of(1.0, radiance), model, 8);
    expect_finite(lit, std::to_string(radiance));
    for (std::size_t i = 0; i < one.picture.pixels().size(); ++i) {
      const double value = one.picture.pixels()[i];
      EXPECT_NEAR(lit.picture.pixels()[i] / radiance, value, 1e-5 * value);
      const double error = one.error.pixels()[i];
      EXPECT_NEAR(lit.error.pixels()[i] / radiance, error, 1e-4 * error + 1e-6 * value);
    }
  }
}

/// Beside a lamp 10^40 times as bright, whose light does not reach there: pi L r^2/(r^2 + h^2), by splats
/// alone, and by all strategies.
TEST(BidirectionalExtremes, ADimLampIsSeenBesideABrightOne) {
  Scene scene;
  scene.materials = {
      {.name = "floor", .kd = Vector3d::Constant(0.5)},
      {.name = "wall", .kd = Vector3d::Zero()},
      {.name = "dim", .kd = Vector3d::Zero(), .emits = Vector3d::Constant(1e-20)},
      {.name = "bright", .kd = Vector3d::Zero(), .emits = Vector3d::Constant(1e20)}};
  scene.meshes = {make_quad({-300, -300, 0}, {300, -300, 0}, {300, 300, 0}, {-300, 300, 0}, 0),
                  make_quad({0, -300, 0}, {0, 300, 0}, {0, 300, 500}, {0, -300, 500}, 1)};
  scene.disks = {
      {.centre = {-100, 0, 100}, .normal = -Vector3d::UnitZ(), .radius_mm = 20, .material = 2},
      {.centre = {100, 0, 100}, .normal = -Vector3d::UnitZ(), .radius_mm = 20, .material = 3}};
  CameraModel model = camera({-200, 0, 90}, {-100, 0, 0});
  model.fx = model.fy = 100.0;  // 22 mm of the floor
  for (const bool is_light_tracing : {false, true}) {
    BidirectionalOptions options;
    options.most_bounces = 1;
    if (is_light_tracing) {
      options.only = PathStrategy{2, 1};
    }
    const Rendered rendered = render(scene, model, is_light_tracing ? 4096 : 256, options);
    expect_finite(rendered, "dim");
    double mean = 0.0;
    for (int i = 0; i < kSize * kSize; ++i) {
      mean += double{rendered.picture(i / kSize, i % kSize)} / (kSize * kSize);
    }
    const double truth = 0.5 * 1e-20 * 400.0 / 10'400.0;
    // A twentieth of the light paths leave the dim lamp, and 2 % of these are seen: 1000.
    EXPECT_NEAR(mean, truth, (is_light_tracing ? 0.12 : 0.03) * truth) << is_light_tracing;
  }
}

TEST(BidirectionalExtremes, AlbedosOfAllAndNothing) {
  const CameraModel model = camera({90, -200, 260}, {0, 0, 20});
  for (const double albedo : {0.0, 1.0}) {
    for (const BsdfKind kind : {BsdfKind::blinn_phong, BsdfKind::oren_nayar, BsdfKind::mirror,
                                BsdfKind::dielectric, BsdfKind::conductor, BsdfKind::coated}) {
      for (const double parameter : {0.0, 1.0}) {
        Material material{.kd = Vector3d::Constant(albedo)};
        material.bsdf = kind;
        material.reflectance = material.kd;
        material.sigma = parameter * std::numbers::pi / 2.0;
        material.roughness = parameter == 0.0 ? 1e-4 : 1.0;
        material.ior = kind == BsdfKind::coated ? 1.2 + 1.3 * parameter : 1.0 + 3.0 * parameter;
        material.k = Vector3d::Constant(3.0);
        expect_finite(render(scene_of(1.0, 1.0, material), model, 4, {.most_bounces = 40}),
                      std::string(to_string(kind)));
      }
    }
  }
}

TEST(BidirectionalExtremes, ACameraWithinAWallOrALampAndLightsWithoutPower) {
  Scene scene = scene_of(1.0, 2.0);
  scene.point_lights.push_back({.intensity = Vector3d::Zero()});
  scene.point_lights.push_back({.position = {50, -80, 0}});  // in the floor
  Mesh flat =
      make_quad({0, 0, 50}, {10, 0, 50}, {10, 0, 50}, {0, 0, 50}, 1);  // no area, a lamp
  scene.meshes.push_back(flat);
  scene.meshes.push_back(scene.meshes[0]);  // the floor twice, at the same height
  // In the floor's plane; inside of the box; inside of the sphere that emits; on the lamp.
  for (const Vector3d& eye : {Vector3d(100, -100, 0), Vector3d(0, 0, 40), Vector3d(120, 60, 60),
                              Vector3d(0, 0, 300), Vector3d(1e6, 1e6, 1e6)}) {
    expect_finite(render(scene, camera(eye, {-20, 10, 1}), 8), "inside");
  }
  scene.materials[1].emits.setZero();
  scene.point_lights.clear();
  const Rendered dark = render(scene, camera({90, -200, 260}, {0, 0, 20}), 4);
  EXPECT_EQ(std::ranges::max(dark.picture.pixels()), 0.0F);
}

}  // namespace
}  // namespace haarlight::render
