// SPDX-License-Identifier: Apache-2.0
#include "render/surface/indirect_light.h"

#include <cmath>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/render/direct/picture.h"
#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"
#include "tests/render/surface/square_camera.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using std::numbers::pi;

CameraModel camera(const Vector3d& eye, const Vector3d& target) {
  return testing::square_camera(eye, target, 1e6, 8);
}

/// Mean over the camera's pixels of red of the indirect light, by light.
struct Indirect {
  std::vector<double> value;
  std::vector<double> error;  ///< by the halves
};
Indirect indirect(const Scene& scene, const std::vector<SquareLight>& lights,
                  const CameraModel& model, const IndirectOptions& options) {
  const RayCaster caster(scene);
  const DirectLight direct(caster, lights);
  const IndirectLight light(scene, caster, direct, options);
  const std::size_t n = lights.size();
  std::vector<LightContribution> scratch(n);
  Indirect found{.value = std::vector<double>(n), .error = std::vector<double>(n)};
  const int n_pixels = model.width * model.height;
  for (int i = 0; i < n_pixels; ++i) {
    const int x = i % model.width;
    const int y = i / model.width;
    const std::optional<SurfacePoint> surface =
        visible_surface(caster, model, x + 0.5, y + 0.5);
    EXPECT_TRUE(surface);
    std::vector<double> even(n);
    std::vector<double> odd(n);
    light.add(*surface, Vector3d::UnitX(), {.x = x, .y = y, .first = 0, .n = options.paths},
              scratch, even, odd);
    for (std::size_t k = 0; k < n; ++k) {
      found.value[k] += 0.5 * (even[k] + odd[k]) / n_pixels;
      const double error = 0.5 * (even[k] - odd[k]) / n_pixels;
      found.error[k] += error * error;
    }
  }
  for (double& error : found.error) {
    error = std::sqrt(error);
  }
  return found;
}

/// An integrating sphere: after the first bounce every point of it receives the same, the flux over
/// the area, times the albedo for each further bounce.
TEST(IndirectLight, AnIntegratingSphereIsLitEvenly) {
  constexpr double kAlbedo = 0.8;
  constexpr double kRadius = 100.0;
  Scene scene;
  scene.materials = {{.name = "wall", .kd = Vector3d::Constant(kAlbedo)}};
  scene.meshes = {make_sphere(Vector3d::Zero(), kRadius, 6, 0)};
  SquareLight led;
  led.centre = {10, -20, 5};
  led.emits = -Vector3d::UnitZ();
  led.width_mm = 6.0;
  led.height_mm = 4.0;
  led.radiance = 2.0;
  SquareLight narrow = led;
  narrow.lobe_mu = 4.0;
  const CameraModel model = camera({30, 10, 20}, {-40, 20, 85});
  for (const int bounces : {1, 3}) {
    const Indirect found =
        indirect(scene, {led, narrow}, model, {.bounces = bounces, .paths = 2048});
    for (std::size_t k = 0; k < 2; ++k) {
      const double mu = k == 0 ? 1.0 : 4.0;
      const double flux = 2.0 * 24.0 * 2.0 * pi / (mu + 1.0);
      const double irradiance = kAlbedo * flux / (4.0 * pi * kRadius * kRadius) *
                                (1.0 - std::pow(kAlbedo, bounces)) / (1.0 - kAlbedo);
      const double truth = kAlbedo / pi * irradiance;
      EXPECT_LE(found.error[k], 8e-3 * truth) << "weak";
      // 1e-3: 32768 facets for the sphere.
      EXPECT_NEAR(found.value[k], truth, 4.0 * found.error[k] + 1e-3 * truth)
          << bounces << ' ' << k;
    }
  }
}

TEST(IndirectLight, IsThatOfPaths) {
  Scene scene;
  scene.materials = {{.name = "floor", .kd = {0.7, 0.5, 0.3}},
                     {.name = "gloss", .kd = {0.3, 0.2, 0.1}, .ks = 0.4, .exponent = 12.0}};
  scene.meshes = {make_quad({-300, -300, 0}, {300, -300, 0}, {300, 300, 0}, {-300, 300, 0}, 0),
                  make_box({60, -80, 1}, {90, 80, 150}, 1),
                  make_box({-160, -90, 1}, {-80, 90, 60}, 0)};
  std::vector<SquareLight> lights;
  for (const Vector3d& centre :
       {Vector3d(0, 0, 300), Vector3d(-200, 100, 280), Vector3d(250, 40, 290)}) {
    SquareLight led;
    led.centre = centre;
    led.width_mm = 25.0;
    led.height_mm = 25.0;
    led.lobe_mu = 1.7;
    lights.push_back(led);
  }
  // The floor between the boxes, and the glossy one's wall.
  for (const Vector3d& target : {Vector3d(20, 10, 0), Vector3d(60, 10, 70)}) {
    const CameraModel model = camera({-30, -20, 200}, target);
    constexpr int kBounces = 3;
    const Indirect found = indirect(scene, lights, model, {.bounces = kBounces, .paths = 1024});
    for (std::size_t k = 0; k < lights.size(); ++k) {
      Scene lit = scene;
      lit.lights = {lights[k]};
      const RayCaster caster(lit);
      const auto mean_of = [&](int bounces) {
        const PathIntegrator integrator(lit, caster, nullptr, model,
                                        {.most_bounces = bounces,
                                         .sure_bounces = 100,
                                         .sampler = SamplerKind::independent});
        Film film(model.width, model.height, surface_layers(false));
        (void)run(integrator, {.samples = 8192}, film);
        const Image<float> mean = film.mean(0);
        const Image<float> error = film.standard_error(0);
        Vector3d sums = Vector3d::Zero();
        for (int i = 0; i < 64; ++i) {
          sums.x() += double{mean(i / 8, i % 8)} / 64.0;
          sums.y() += std::pow(double{error(i / 8, i % 8)} / 64.0, 2);
        }
        return sums;
      };
      const Vector3d all = mean_of(kBounces + 1);
      const Vector3d direct = mean_of(1);
      const double truth = all.x() - direct.x();
      const double error = std::sqrt(all.y() + direct.y()) + found.error[k];
      ASSERT_GT(truth, 0.0);
      EXPECT_LE(error, 0.03 * truth) << "weak";
      EXPECT_NEAR(found.value[k], truth, 4.0 * error) << target.transpose() << ' ' << k;
    }
  }
}

}  // namespace
}  // namespace haarlight::render
