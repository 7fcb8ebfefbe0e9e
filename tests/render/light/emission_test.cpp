// SPDX-License-Identifier: Apache-2.0
#include "render/light/emission.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/render/rays/ray_caster.h"
#include "render/sampling/sampler.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// Lights of all kinds, far from each other.
Scene all_lights() {
  Scene scene;
  scene.materials = {{.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d(3, 2, 1)}};
  scene.meshes = {make_box({-30, -20, -10}, {30, 20, 10}, 0)};
  scene.spheres = {{.centre = {200, 0, 0}, .radius_mm = 25, .material = 0}};
  scene.disks = {
      {.centre = {0, 200, 0}, .normal = {0.6, 0.0, -0.8}, .radius_mm = 30, .material = 0}};
  scene.lights = {
      {.centre = {0, 0, 200}, .width_mm = 12, .height_mm = 20, .radiance = 9, .lobe_mu = 3.5}};
  scene.point_lights = {{.position = {-200, 0, 0}, .intensity = Vector3d(900, 800, 700)},
                        {.position = {0, -200, 0},
                         .intensity = Vector3d(900, 800, 700),
                         .axis = Vector3d(0.6, 0.8, 0.0),
                         .cos_full = 0.9,
                         .cos_end = 0.6}};
  scene.directional_lights = {
      {.direction = Vector3d(0.48, 0.64, -0.6), .irradiance = Vector3d(0.03, 0.02, 0.01)}};
  scene.environment = EnvironmentSource{};
  return scene;
}

/// What a ray carries is the light's power in the mean (one choice of eight lights: 1 % is 4 standard
/// errors or more of 2^18 points of Sobol's), and times its density what is emitted along it: radiance times
/// cosine, to rounding.
TEST(Emission, RaysCarryTheLightsPower) {
  const Scene scene = all_lights();
  Image<float> sky(4, 8, 1);
  for (std::size_t i = 0; i < sky.pixels().size(); ++i) {
    sky.pixels()[i] = 0.001F * static_cast<float>(1 + i % 5);
  }
  const Environment environment = Environment::from_picture(sky, "made");
  const RayCaster caster(scene);
  const SceneLights lights(scene, &environment, caster.scene_radius_mm(), LightChoice::power);
  ASSERT_EQ(lights.size(), 8U);
  const Emitters emitters(lights, caster.scene_middle());
  const PixelSamples numbers(SamplerKind::sobol, 5, 0, 0);
  constexpr std::uint32_t kRays = 1U << 18U;
  std::vector<double> power_of(lights.size());
  for (std::uint32_t i = 0; i < kRays; ++i) {
    const Emission ray = emitters.emit(numbers.two(i, 0), numbers.two(i, 1));
    if (!ray.is_found) {
      continue;
    }
    power_of[ray.light] += ray.power.mean() / kRays;
    // As a point on its way sees it.
    const Vector3d from = ray.point + 50.0 * ray.direction;
    const LightHit back{.direction = -ray.direction, .distance_mm = 50.0, .cosine = ray.cosine};
    const double density = emitters.density(ray.light, back);
    ASSERT_GT(density, 0.0) << ray.light;
    const Light& light = lights[ray.light];
    double emitted = 0.0;
    if (const auto* const led = std::get_if<LedLight>(&light)) {
      emitted = led->radiance(ray.cosine).mean() * ray.cosine;
    } else if (std::holds_alternative<EnvironmentSourceLight>(light)) {
      emitted = environment.radiance(back.direction).mean();
    } else if (std::holds_alternative<PointSource>(light)) {
      emitted = sample(light, from, Vector2d(0.5, 0.5)).radiance.mean() * 2500.0;
    } else if (std::holds_alternative<DirectionalSource>(light)) {
      emitted = 0.02;
    } else {
      emitted = 2.0 * ray.cosine;
    }
    ASSERT_NEAR(ray.power.mean() * density / emitted, 1.0, 1e-9) << ray.light;
    // All that comes from afar goes through the scene's sphere.
    if (ray.is_far) {
      const Vector3d to_middle = caster.scene_middle() - ray.point;
      EXPECT_LE(to_middle.cross(ray.direction).norm(),
                caster.scene_radius_mm() * (1.0 + 1e-12));
      EXPECT_GE(to_middle.dot(ray.direction), caster.scene_radius_mm() * (1.0 - 1e-12));
    }
  }
  for (std::size_t i = 0; i < lights.size(); ++i) {
    EXPECT_NEAR(power_of[i] / render::power(lights[i]), 1.0, 0.01) << i;
  }
}

/// Where a light is asked for, the density is that of what is drawn; lights of one point or direction
/// have none.
TEST(Emission, AskedDensitiesAreThoseOfTheSamples) {
  const Scene scene = all_lights();
  const RayCaster caster(scene);
  const SceneLights lights(scene, nullptr, caster.scene_radius_mm(), LightChoice::power);
  const PixelSamples numbers(SamplerKind::sobol, 6, 0, 0);
  const Vector3d from(40, 30, -300);
  for (std::size_t i = 0; i < lights.size(); ++i) {
    int n_found = 0;
    for (std::uint32_t k = 0; k < 64; ++k) {
      const LightSample drawn = sample(lights[i], from, numbers.two(k, 0));
      if (!drawn.is_found) {
        continue;
      }
      ++n_found;
      const LightHit hit{.direction = drawn.direction,
                         .distance_mm = drawn.distance_mm,
                         .cosine = cosine_at(lights[i], drawn)};
      EXPECT_NEAR(asked_density(lights[i], from, hit) / drawn.density, 1.0, 1e-9) << i;
    }
    EXPECT_TRUE(n_found > 0 || i == 5) << i;  // the spot looks elsewhere
  }
}

}  // namespace
}  // namespace haarlight::render
