// SPDX-License-Identifier: Apache-2.0
/// @file
/// Scenes at the ends of what can be written: no NaN, no picture that is wrong in silence.

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"
#include "tests/render/surface/square_camera.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using std::numbers::pi;

CameraModel camera(const Vector3d& eye, const Vector3d& target) {
  return testing::square_camera(eye, target, 30.0, 24);
}

struct Rendered {
  Image<float> picture;
  Image<float> error;
};
Rendered render(const Scene& scene, const CameraModel& model, std::uint32_t samples,
                PathOptions options = {}) {
  const RayCaster caster(scene);
  const PathIntegrator integrator(scene, caster, nullptr, model, options);
  Film film(model.width, model.height, surface_layers(false));
  (void)run(integrator, {.samples = samples}, film);
  return {.picture = film.mean(0), .error = film.standard_error(0)};
}

void expect_finite(const Rendered& rendered, const std::string& what) {
  for (const Image<float>* image : {&rendered.picture, &rendered.error}) {
    for (const float value : image->pixels()) {
      ASSERT_TRUE(std::isfinite(value) && value >= 0.0F) << what << ": " << value;
    }
  }
}

/// A box on a floor under a lamp of each kind that stands somewhere, all lengths times `scale`.
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

TEST(PathExtremes, APictureDoesNotDependOnTheScale) {
  const Rendered one = render(scene_of(1.0, 2.0), camera({90, -200, 260}, {0, 0, 20}), 16);
  expect_finite(one, "1");
  for (const double scale : {1e-6, 1e6}) {
    const Rendered scaled =
        render(scene_of(scale, 2.0),
               camera(scale * Vector3d(90, -200, 260), scale * Vector3d(0, 0, 20)), 16);
    expect_finite(scaled, std::to_string(scale));
    int n_other = 0;  // a ray that meets an edge in single precision may meet another triangle
    for (std::size_t i = 0; i < one.picture.pixels().size(); ++i) {
      const double a = one.picture.pixels()[i];
      n_other += std::abs(scaled.picture.pixels()[i] - a) > 1e-4 * a + 1e-6 ? 1 : 0;
    }
    EXPECT_LE(n_other, 3 * 24 * 24 / 50) << scale;
  }
}

TEST(PathExtremes, APictureIsInProportionToItsLight) {
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

/// Bright and dim lamps together: where the bright one does not reach, the dim one is seen.
TEST(PathExtremes, ADimLampIsSeenBesideABrightOne) {
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
  model.fx = model.fy = 1e6;
  for (const LightChoice lights : {LightChoice::power, LightChoice::tree}) {
    PathOptions options;
    options.most_bounces = 1;
    options.lights = lights;
    const Rendered rendered = render(scene, model, 1024, options);
    expect_finite(rendered, std::string(to_string(lights)));
    double mean = 0.0;
    for (int i = 0; i < 24 * 24; ++i) {
      mean += double{rendered.picture(i / 24, i % 24)} / (24 * 24);
    }
    // pi L r^2/(r^2 + h^2) over the disk's axis.
    const double truth = 0.5 * 1e-20 * 400.0 / 10'400.0;
    EXPECT_NEAR(mean, truth, 0.02 * truth) << to_string(lights);
  }
}

TEST(PathExtremes, DegenerateSurfacesHarmNothing) {
  Scene scene = scene_of(1.0, 2.0);
  Mesh flat =
      make_quad({0, 0, 50}, {10, 0, 50}, {10, 0, 50}, {0, 0, 50}, 1);  // no area, a lamp
  scene.meshes.push_back(flat);
  flat.material = 0;
  scene.meshes.push_back(flat);
  scene.meshes.push_back(scene.meshes[0]);  // the floor twice, at the same height
  scene.meshes.push_back(scene.meshes[2]);  // the lamp twice
  scene.point_lights.push_back({.intensity = Vector3d::Zero()});
  scene.point_lights.push_back({.position = {50, -80, 0}});  // in the floor
  expect_finite(render(scene, camera({90, -200, 260}, {0, 0, 20}), 16), "degenerate");
}

TEST(PathExtremes, AlbedosOfAllAndNothing) {
  const CameraModel model = camera({90, -200, 260}, {0, 0, 20});
  for (const double albedo : {0.0, 1.0}) {
    for (const BsdfKind kind : {BsdfKind::blinn_phong, BsdfKind::oren_nayar, BsdfKind::mirror,
                                BsdfKind::dielectric, BsdfKind::conductor, BsdfKind::coated}) {
      for (const double parameter : {0.0, 1.0}) {
        Material material{.kd = Vector3d::Constant(albedo)};
        material.bsdf = kind;
        material.reflectance = material.kd;
        material.sigma = parameter * pi / 2.0;
        material.roughness = parameter == 0.0 ? 1e-4 : 1.0;
        material.ior = kind == BsdfKind::coated ? 1.2 + 1.3 * parameter : 1.0 + 3.0 * parameter;
        material.k = Vector3d::Constant(3.0);
        PathOptions options;
        options.most_bounces = 40;
        expect_finite(render(scene_of(1.0, 1.0, material), model, 8, options),
                      std::string(to_string(kind)));
      }
    }
  }
}

TEST(PathExtremes, ACameraWithinAWallOrALamp) {
  const Scene scene = scene_of(1.0, 2.0);
  // In the floor's plane; inside of the box; inside of the sphere that emits; on the lamp.
  for (const Vector3d& eye : {Vector3d(100, -100, 0), Vector3d(0, 0, 40), Vector3d(120, 60, 60),
                              Vector3d(0, 0, 300), Vector3d(1e6, 1e6, 1e6)}) {
    expect_finite(render(scene, camera(eye, {-20, 10, 1}), 8), "inside");
  }
}

}  // namespace
}  // namespace haarlight::render
