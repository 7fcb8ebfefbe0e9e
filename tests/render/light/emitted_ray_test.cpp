// SPDX-License-Identifier: Apache-2.0
#include "render/light/emitted_ray.h"

#include <cmath>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "haarlight/render/rays/ray_caster.h"
#include "render/light/scene_lights.h"
#include "render/sampling/sampler.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

const Vector3d kRadiance(3, 2, 1);
const Vector3d kMiddle(10, -20, 30);
constexpr double kSceneRadius = 150.0;

/// One of each kind, above the plane z = 0.
std::vector<Light> one_of_each(const Environment& environment) {
  Mesh mesh = make_quad({-50, -30, 200}, {-50, 40, 200}, {60, 40, 200}, {60, -30, 200}, 0);
  mesh.vertices.insert(mesh.vertices.end(), {{100, -30, 90}, {100, 10, 120}, {160, 10, 120}});
  mesh.triangles.emplace_back(4, 5, 6);
  SquareLight led;
  led.centre = {-40, 30, 120};
  led.emits = Vector3d(0.3, -0.2, -0.9).normalized();
  led.u = led.emits.unitOrthogonal();
  led.v = led.emits.cross(led.u);
  led.width_mm = 12;
  led.height_mm = 20;
  led.lobe_mu = 3.5;
  led.radiance = 2.0;
  const Vector3d down = Vector3d(0.2, 0.1, -0.8).normalized();
  return {
      MeshLight(mesh, kRadiance),
      SphereLight{{.centre = {-20, 30, 100}, .radius_mm = 35}, kRadiance},
      DiskLight{{.centre = {20, -60, 120}, .normal = down, .radius_mm = 45}, kRadiance},
      LedLight{led},
      PointSource{{.position = {30, 20, 80}, .intensity = kRadiance}},
      PointSource{{.position = {30, 20, 80},
                   .intensity = kRadiance,
                   .axis = down,
                   .cos_full = 0.95,
                   .cos_end = 0.7}},
      PointSource{{.position = {30, 20, 80},
                   .intensity = kRadiance,
                   .axis = down,
                   .cos_full = 0.9,
                   .cos_end = 0.9}},
      DirectionalSource{{.direction = down, .irradiance = kRadiance}, kSceneRadius},
      EnvironmentSourceLight{EnvironmentLight(environment, 2.0), kSceneRadius},
  };
}

Environment patterned() {
  Image<float> picture(8, 16, 3);
  std::uint32_t state = 1;
  for (float& value : picture.pixels()) {
    state = state * 1664525U + 1013904223U;
    value = static_cast<float>(state >> 24U) / 64.0F;
  }
  picture(2, 3, 0) = 100.0F;
  return Environment::from_picture(picture, "made");
}

std::string name_of(std::size_t i) {
  return std::vector<std::string>{"mesh", "sphere",     "disk",        "led",        "point",
                                  "spot", "sharp spot", "directional", "environment"}[i];
}

/// Each ray carries the power, in the mean of the colours: to rounding, but that a lat-long texel's
/// density is by its solid angle.
TEST(EmittedRay, CarriesThePower) {
  const Environment environment = patterned();
  const std::vector<Light> lights = one_of_each(environment);
  const PixelSamples numbers(SamplerKind::sobol, 3, 0, 0);
  for (std::size_t i = 0; i < lights.size(); ++i) {
    for (std::uint32_t k = 0; k < 2000; ++k) {
      const EmittedRay ray = emit(lights[i], kMiddle, numbers.two(k, 0), numbers.two(k, 1));
      ASSERT_NEAR(ray.flux().mean(), power(lights[i]), 1e-9 * power(lights[i])) << name_of(i);
      ASSERT_NEAR(ray.direction.norm(), 1.0, 1e-12);
      ASSERT_NEAR(ray.normal.norm(), ray.has_one_position ? 0.0 : 1.0, 1e-12);
      ASSERT_NEAR(ray.cosine, ray.has_one_position ? 1.0 : ray.normal.dot(ray.direction), 1e-9);
    }
  }
}

TEST(EmittedRay, HasTheDensityThatIsSaid) {
  const Environment environment = patterned();
  const std::vector<Light> lights = one_of_each(environment);
  const PixelSamples numbers(SamplerKind::sobol, 4, 0, 0);
  for (std::size_t i = 0; i < lights.size(); ++i) {
    for (std::uint32_t k = 0; k < 2000; ++k) {
      const EmittedRay ray = emit(lights[i], kMiddle, numbers.two(k, 0), numbers.two(k, 1));
      const EmissionDensity density = emission_density(lights[i], ray.cosine, ray.direction);
      // Rounded directions change a lobe's foot and a spot's edge the most.
      ASSERT_NEAR(density.position, ray.position_density, 1e-12 * ray.position_density)
          << name_of(i);
      ASSERT_NEAR(density.direction, ray.direction_density, 1e-6 * ray.direction_density + 1e-9)
          << name_of(i);
    }
  }
}

/// What arrives on parts of the floor: counted by rays from the light, against the light's
/// irradiance by `sample` (which is held to closed forms), at 2^17 points of the floor. With 16
/// scrambled sets of 2^15 rays: Student's t with 15 degrees of freedom, |t| <= 5.3 is one false
/// alarm in 100 runs of all 81 parts (two-sided 1e-4 each).
TEST(EmittedRay, ArrivesWhereItShould) {
  const Environment environment = patterned();
  const std::vector<Light> lights = one_of_each(environment);
  constexpr std::uint32_t kRays = 1 << 15;
  constexpr int kSets = 16;
  constexpr int kSide = 3;
  constexpr double kWidth = 50.0;
  const Vector2d corner = kMiddle.head<2>() - Vector2d::Constant(0.5 * kSide * kWidth);
  for (std::size_t i = 0; i < lights.size(); ++i) {
    std::vector<Vector3d> expected(std::size_t{kSide} * kSide, Vector3d::Zero());
    const PixelSamples at(SamplerKind::sobol, 5, 0, 0);
    constexpr std::uint32_t kPoints = 1 << 17;
    for (std::uint32_t k = 0; k < kPoints; ++k) {
      const Vector2d part = kSide * at.two(k, 0);
      const Vector2d xy = corner + kWidth * part;
      const LightSample found = sample(lights[i], {xy.x(), xy.y(), 0.0}, at.two(k, 1));
      if (found.is_found && found.direction.z() > 0.0) {
        expected[static_cast<std::size_t>(part.y()) * kSide +
                 static_cast<std::size_t>(part.x())] +=
            found.direction.z() / found.density * (kSide * kWidth * kSide * kWidth / kPoints) *
            found.radiance;
      }
    }
    std::vector<std::vector<double>> arrived(std::size_t{kSide} * kSide,
                                             std::vector<double>(kSets));
    for (int set = 0; set < kSets; ++set) {
      const PixelSamples numbers(SamplerKind::sobol, 6, set, 0);
      for (std::uint32_t k = 0; k < kRays; ++k) {
        const EmittedRay ray = emit(lights[i], kMiddle, numbers.two(k, 0), numbers.two(k, 1));
        if (!(ray.direction.z() < 0.0)) {
          continue;
        }
        const double t = -ray.origin.z() / ray.direction.z();
        const Vector2d part = ((ray.origin + t * ray.direction).head<2>() - corner) / kWidth;
        if (part.minCoeff() >= 0.0 && part.maxCoeff() < kSide && t > 0.0) {
          arrived[static_cast<std::size_t>(part.y()) * kSide +
                  static_cast<std::size_t>(part.x())][static_cast<std::size_t>(set)] +=
              ray.flux().y() / kRays;
        }
      }
    }
    for (std::size_t part = 0; part < arrived.size(); ++part) {
      double mean = 0.0;
      for (const double one : arrived[part]) {
        mean += one / kSets;
      }
      double squares = 0.0;
      for (const double one : arrived[part]) {
        squares += (one - mean) * (one - mean);
      }
      const double error = std::sqrt(squares / (kSets - 1) / kSets);
      const double truth = expected[part].y();
      // And the reference's own error.
      EXPECT_NEAR(mean, truth, 5.3 * error + 2e-3 * truth) << name_of(i) << " part " << part;
      EXPECT_LT(error, 0.01 * power(lights[i]) / 9.0) << name_of(i) << ": too weak a test";
    }
  }
}

TEST(EmittedRay, LightsAreDrawnByTheirPower) {
  Scene scene;
  scene.materials = {{.name = "lamp", .emits = kRadiance}};
  scene.spheres = {{.radius_mm = 10, .material = 0},
                   {.centre = {90, 0, 0}, .radius_mm = 20, .material = 0}};
  scene.point_lights = {{.intensity = Vector3d::Constant(500)}};
  scene.directional_lights = {{.irradiance = Vector3d::Constant(0.1)}};
  const RayCaster caster(scene);
  const SceneLights lights(scene, nullptr, caster.scene_radius_mm(), LightChoice::all);
  ASSERT_EQ(lights.size(), 4U);
  double sum = 0.0;
  for (std::size_t i = 0; i < lights.size(); ++i) {
    sum += power(lights[i]);
  }
  std::vector<double> fractions(lights.size());
  constexpr std::uint32_t kSamples = 1 << 14;
  const PixelSamples numbers(SamplerKind::sobol, 5, 0, 0);
  for (std::uint32_t i = 0; i < kSamples; ++i) {
    const ChosenLight chosen = lights.choose_emitter(numbers.two(i, 0));
    fractions[chosen.index] += 1.0 / kSamples;
    EXPECT_EQ(chosen.probability, lights.emitter_probability(chosen.index));
    const EmittedRay ray =
        emit(lights[chosen.index], caster.scene_middle(), chosen.square, numbers.two(i, 1));
    ASSERT_NEAR(ray.flux().mean() / chosen.probability, sum, 1e-9 * sum);
  }
  for (std::size_t i = 0; i < lights.size(); ++i) {
    EXPECT_NEAR(lights.emitter_probability(i), power(lights[i]) / sum, 1e-12);
    EXPECT_NEAR(fractions[i], lights.emitter_probability(i), 4.0 / kSamples);
  }
}

/// Powers and radii that differ by 10^±20 and 10^±6.
TEST(EmittedRay, HasNoLimitsOfSize) {
  const Environment environment = patterned();
  const PixelSamples numbers(SamplerKind::sobol, 9, 0, 0);
  for (const double scale : {1e-6, 1e6}) {
    for (const double bright : {1e-20, 1e20}) {
      const std::vector<Light> lights = {
          SphereLight{{.radius_mm = scale}, bright * kRadiance},
          DiskLight{{.radius_mm = scale}, bright * kRadiance},
          DirectionalSource{{.irradiance = bright * kRadiance}, scale},
          EnvironmentSourceLight{EnvironmentLight(environment, bright), scale}};
      for (const Light& light : lights) {
        for (std::uint32_t k = 0; k < 100; ++k) {
          const EmittedRay ray =
              emit(light, Vector3d::Zero(), numbers.two(k, 0), numbers.two(k, 1));
          ASSERT_NEAR(ray.flux().mean() / power(light), 1.0, 1e-9);
          ASSERT_LE(ray.origin.norm(), 2.5 * scale);
        }
      }
    }
  }
}

}  // namespace
}  // namespace haarlight::render
