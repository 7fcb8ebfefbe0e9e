// SPDX-License-Identifier: Apache-2.0
#include "render/light/scene_lights.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "haarlight/render/light/environment_texels.h"
#include "haarlight/render/rays/ray_caster.h"
#include "render/sampling/sampler.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using std::numbers::pi;

/// A floor, and one surface of each kind that emits.
Scene lamps() {
  Scene scene;
  scene.materials = {{.name = "dark"}, {.name = "lamp", .emits = Vector3d(3, 2, 1)}};
  Mesh quads = make_quad({-50, -30, 200}, {-50, 40, 200}, {60, 40, 200}, {60, -30, 200}, 1);
  const Mesh leaning =
      make_quad({100, -30, 90}, {100, 10, 120}, {160, 10, 120}, {160, -30, 90}, 1);
  for (const Eigen::Vector3i& triangle : leaning.triangles) {
    quads.triangles.emplace_back(triangle.array() + static_cast<int>(quads.vertices.size()));
  }
  quads.uvs.clear();
  quads.vertices.insert(quads.vertices.end(), leaning.vertices.begin(), leaning.vertices.end());
  scene.meshes = {make_quad({-500, -500, 0}, {500, -500, 0}, {500, 500, 0}, {-500, 500, 0}, 0),
                  quads};
  scene.spheres = {{.centre = {-120, 80, 100}, .radius_mm = 35, .material = 1}};
  scene.disks = {{.centre = {20, -160, 120},
                  .normal = Vector3d(0.1, 0.6, -0.8).normalized(),
                  .radius_mm = 45,
                  .material = 1}};
  return scene;
}

Environment patterned(int width, int height) {
  Image<float> picture(height, width, 3);
  std::uint32_t state = 1;
  for (float& value : picture.pixels()) {
    state = state * 1664525U + 1013904223U;
    value = static_cast<float>(state >> 24U) / 64.0F;
  }
  for (int c = 0; c < 3; ++c) {
    picture(height / 3, width / 5, c) = 500.0F;  // a sun
    picture(height / 2, width / 2, c) = 0.0F;
  }
  return Environment::from_picture(picture, "made");
}

/// Rays along sampled directions meet the light where the sample says, and `density` says of them
/// what `sample` says.
TEST(Light, SamplesAreWhereRaysMeetThem) {
  const Scene scene = lamps();
  const RayCaster caster(scene);
  const SceneLights lights(scene, nullptr, caster.scene_radius_mm(), LightChoice::power);
  ASSERT_EQ(lights.size(), 3U);
  const PixelSamples numbers(SamplerKind::sobol, 1, 0, 0);
  for (const Vector3d& from :
       {Vector3d(0, 0, 1), Vector3d(-200, 160, 3), Vector3d(160, -90, 20)}) {
    for (std::uint32_t surface = 1; surface < 4; ++surface) {
      const std::optional<std::size_t> light = lights.of_surface(surface);
      ASSERT_TRUE(light);
      int n_found = 0;
      int n_met = 0;
      for (std::uint32_t i = 0; i < 2000; ++i) {
        const LightSample found = sample(lights[*light], from, numbers.two(i, surface));
        if (!found.is_found) {
          continue;
        }
        ++n_found;
        EXPECT_NEAR(found.direction.norm(), 1.0, 1e-12);
        EXPECT_GT(found.density, 0.0);
        const Ray ray{.origin = from, .direction = found.direction};
        const RawHit raw = caster.intersect(ray);
        if (!raw.is_hit() || raw.mesh != surface) {
          continue;  // another lamp is in front, or it is missed by the rim's rounding
        }
        ++n_met;
        const Hit hit = caster.surface_at(ray, raw);
        EXPECT_TRUE(hit.is_front);
        if (-found.normal.dot(found.direction) > 1e-2) {
          EXPECT_NEAR(hit.distance_mm, found.distance_mm, 1e-7 * found.distance_mm);
          EXPECT_NEAR((hit.flat_normal - found.normal).norm(), 0.0, 1e-7);
          const LightHit met{.direction = ray.direction,
                             .distance_mm = hit.distance_mm,
                             .cosine = -hit.flat_normal.dot(ray.direction)};
          EXPECT_NEAR(density(lights[*light], from, met), found.density, 1e-5 * found.density);
        }
      }
      EXPECT_GT(n_found, 500) << surface;
      EXPECT_GT(n_met, n_found / 4) << surface;
    }
  }
}

/// The mean of 1/density over the samples is the solid angle of the light, the mean of
/// cos/density its irradiance: both known.
TEST(Light, DensitiesAreThoseOfTheSamples) {
  const PixelSamples numbers(SamplerKind::sobol, 7, 0, 0);
  constexpr std::uint32_t kSamples = 1 << 16;
  const auto mean = [&](const Light& light, const Vector3d& from, const auto& value) {
    double sum = 0.0;
    for (std::uint32_t i = 0; i < kSamples; ++i) {
      const LightSample found = sample(light, from, numbers.two(i, 0));
      sum += found.is_found ? value(found) / found.density : 0.0;
    }
    return sum / kSamples;
  };
  const auto one = [](const LightSample&) { return 1.0; };
  const auto cosine = [](const LightSample& found) { return found.direction.z(); };
  const Vector3d white = Vector3d::Ones();

  // A sphere of radius r at distance d: 2 pi (1 - sqrt(1 - (r/d)^2)), pi (r/d)^2 cos.
  for (const double ratio : {1e-6, 0.01, 0.5, 0.9, 0.999999}) {
    const double distance = 200.0;
    const double s = ratio;
    const Light light = SphereLight{
        {.centre = Vector3d(0.6, 0, 0.8) * distance, .radius_mm = ratio * distance}, white};
    const double omega = 2.0 * pi * s * s / (1.0 + std::sqrt(1.0 - s * s));
    EXPECT_NEAR(mean(light, Vector3d::Zero(), one), omega, 1e-11 * omega)
        << ratio;        // 65536 roundings
    if (ratio <= 0.5) {  // above the horizon
      const double irradiance = pi * s * s * 0.8;
      EXPECT_NEAR(mean(light, Vector3d::Zero(), cosine), irradiance, 1e-6 * irradiance)
          << ratio;
    }
  }
  // A disk over its axis: pi r^2/(r^2 + h^2), and tiny.
  for (const double radius : {1e-4, 10.0, 100.0, 300.0}) {
    const Light light = DiskLight{
        {.centre = {0, 0, 100}, .normal = -Vector3d::UnitZ(), .radius_mm = radius}, white};
    const double irradiance = pi * radius * radius / (radius * radius + 1e4);
    EXPECT_NEAR(mean(light, Vector3d::Zero(), cosine), irradiance, 2e-4 * irradiance) << radius;
  }
  // An environment: 4 pi, and all of it is seen from everywhere.
  for (const auto& [width, height] : {std::pair{16, 8}, {64, 32}, {32, 24}, {18, 24}, {6, 1}}) {
    const Environment environment = patterned(width, height);
    const Light light = EnvironmentSourceLight{EnvironmentLight(environment, 2.0), 1.0};
    double dark = 0.0;  // is never drawn
    double up = 0.0;
    const EnvironmentTexels texels(environment);
    for (int row = 0; row < texels.n_rows(); ++row) {
      texels.for_each(row, [&](const EnvironmentTexel& texel) {
        dark += texel.radiance.isZero() ? texel.solid_angle : 0.0;
      });
    }
    // Radiance times height over the upper half sphere, on a fine raster.
    constexpr int kRaster = 1200;
    for (int y = 0; y < kRaster; ++y) {
      for (int x = 0; x < 2 * kRaster; ++x) {
        const double z = (y + 0.5) / kRaster;
        const double phi = pi * (x + 0.5) / kRaster;
        const double r = std::sqrt(1.0 - z * z);
        up += 2.0 *
              environment.radiance(Vector3d(r * std::cos(phi), r * std::sin(phi), z)).x() * z *
              pi / (double{kRaster} * kRaster);
      }
    }
    EXPECT_NEAR(mean(light, Vector3d::Zero(), one), 4.0 * pi - dark, 0.03) << width;
    EXPECT_NEAR(mean(light, Vector3d::Zero(),
                     [](const LightSample& found) {
                       return found.radiance.x() * std::max(0.0, found.direction.z());
                     }),
                up, 4e-3 * up)
        << width << 'x' << height;
  }
}

/// Pearson's chi-squared of the texels that are drawn; at one in 10^6 for each environment.
TEST(Light, AnEnvironmentIsDrawnByItsLight) {
  for (const auto& [width, height] : {std::pair{16, 8}, {24, 18}}) {
    Environment environment = patterned(width, height);
    environment.rotate(1.0);
    const EnvironmentLight light(environment, 3.0);
    const auto n_cols = static_cast<std::size_t>(environment.row_texels());
    const std::size_t n_cells = n_cols * static_cast<std::size_t>(environment.n_rows());
    std::vector<double> expected(n_cells);
    double total = 0.0;
    for (int row = 0; row < environment.n_rows(); ++row) {
      for (int col = 0; col < environment.row_texels(); ++col) {
        const EnvironmentPosition middle{.row = row, .col = col};
        double& cell =
            expected[static_cast<std::size_t>(row) * n_cols + static_cast<std::size_t>(col)];
        cell = environment.radiance_at(middle).mean() * environment.solid_angle_density(middle);
        total += cell;
      }
    }
    EXPECT_NEAR(light.total(), 3.0 * total, 1e-9 * total);
    std::vector<double> found(n_cells);
    constexpr std::uint32_t kSamples = 400'000;
    const PixelSamples numbers(SamplerKind::independent, 3, 0, 0);
    for (std::uint32_t i = 0; i < kSamples; ++i) {
      const EnvironmentDirection drawn = light.sample(numbers.two(i, 0));
      const EnvironmentPosition position = environment.position_of(drawn.direction);
      found[static_cast<std::size_t>(position.row) * n_cols +
            static_cast<std::size_t>(position.col)] += 1.0;
      EXPECT_NEAR(light.density(drawn.direction), drawn.density, 1e-6 * drawn.density);
    }
    double chi_squared = 0.0;
    int n_free = -1;
    for (std::size_t i = 0; i < n_cells; ++i) {
      const double n = expected[i] / total * kSamples;
      if (n == 0.0) {
        EXPECT_EQ(found[i], 0.0);
        continue;
      }
      ASSERT_GT(n, 5.0);
      chi_squared += (found[i] - n) * (found[i] - n) / n;
      ++n_free;
    }
    // Normal approximation of chi-squared [Wilson31], 4.75 deviations.
    const double k = 2.0 / (9.0 * n_free);
    EXPECT_LT(std::cbrt(chi_squared / n_free), 1.0 - k + 4.75 * std::sqrt(k));
  }
}

TEST(Light, PositionsOfAnEnvironmentAreFoundAgain) {
  for (const auto& [width, height] :
       {std::pair{2, 1}, {16, 8}, {4096, 2048}, {6, 1}, {24, 18}, {96, 128}}) {
    Environment environment = Environment::from_picture(Image<float>(height, width, 1), "made");
    environment.rotate(-2.0);
    const PixelSamples numbers(SamplerKind::sobol, 2, width, height);
    for (std::uint32_t i = 0; i < 4000; ++i) {
      const Vector2d texel = numbers.two(i, 0);
      const Vector2d within = 0.01 * Vector2d::Ones() + 0.98 * numbers.two(i, 1);
      const EnvironmentPosition position{
          .row = static_cast<int>(texel.y() * environment.n_rows()),
          .col = static_cast<int>(texel.x() * environment.row_texels()),
          .u = within.x(),
          .v = within.y()};
      const Vector3d direction = environment.direction(position);
      EXPECT_NEAR(direction.norm(), 1.0, 1e-14);
      const EnvironmentPosition again = environment.position_of(3.0 * direction);
      ASSERT_EQ(again.row, position.row);
      ASSERT_EQ(again.col, position.col);
      EXPECT_NEAR(again.u, position.u, 1e-8);
      EXPECT_NEAR(again.v, position.v, 1e-8);
    }
  }
}

/// Where lamps() is lit from all sides.
LitPoint on_the_floor(double x, double y) {
  return {.point = {x, y, 0.0}, .normal = Vector3d::UnitZ()};
}

TEST(SceneLights, AreChosenByTheirProbabilities) {
  Scene scene = lamps();
  scene.point_lights = {{.intensity = Vector3d::Constant(5e4)},
                        {.intensity = Vector3d::Zero()},  // left out
                        {.position = {3, 0, 90}, .intensity = Vector3d::Constant(1e-30)}};
  scene.directional_lights = {{.irradiance = Vector3d::Constant(0.1)}};
  const RayCaster caster(scene);
  for (const LightChoice choice :
       {LightChoice::uniform, LightChoice::power, LightChoice::tree}) {
    const SceneLights lights(scene, nullptr, caster.scene_radius_mm(), choice);
    ASSERT_EQ(lights.size(), 6U);
    for (const LitPoint& at : {on_the_floor(10, 20), on_the_floor(-300, -200)}) {
      std::vector<double> fractions(lights.size());
      constexpr int kSamples = 1 << 16;
      const PixelSamples numbers(SamplerKind::sobol, 5, 0, 0);
      for (std::uint32_t i = 0; i < kSamples; ++i) {
        const std::optional<ChosenLight> chosen = lights.choose(at, numbers.two(i, 0));
        ASSERT_TRUE(chosen);
        EXPECT_GE(chosen->square.minCoeff(), 0.0);
        EXPECT_LE(chosen->square.maxCoeff(), 1.0);
        EXPECT_NEAR(chosen->probability, lights.probability(chosen->index, at),
                    1e-12 * chosen->probability);
        fractions[chosen->index] += 1.0 / kSamples;
      }
      double sum = 0.0;
      for (std::size_t i = 0; i < lights.size(); ++i) {
        EXPECT_NEAR(fractions[i], lights.probability(i, at), 1e-4);
        if (choice != LightChoice::tree) {
          EXPECT_GE(lights.probability(i, at), 0.1 / 6.0 - 1e-12)
              << "a dim light that is hardly asked";
        }
        sum += lights.probability(i, at);
      }
      EXPECT_NEAR(sum, 1.0, 1e-12);
    }
  }
}

/// Lights of every kind, many of them, and points all around: whatever contributes may be drawn.
TEST(SceneLights, ATreeLeavesOutOnlyWhatCannotContribute) {
  Scene scene = lamps();
  const PixelSamples numbers(SamplerKind::sobol, 21, 0, 0);
  const auto vector = [&](std::uint32_t i, std::uint32_t dimension) -> Vector3d {
    const Vector2d a = numbers.two(i, dimension);
    return Vector3d(a.x(), a.y(), numbers.one(i, dimension + 1)).array() - 0.5;
  };
  for (std::uint32_t i = 0; i < 300; ++i) {
    PointLight light{.position = 400.0 * vector(i, 0),
                     .intensity = Vector3d::Constant(1.0 + i % 17),
                     .axis = vector(i, 2).normalized()};
    if (i % 3 != 0) {
      light.cos_end = std::cos(0.01 * i);
      light.cos_full = std::cos(0.005 * i);
    }
    scene.point_lights.push_back(light);
    scene.disks.push_back({.centre = 400.0 * vector(i, 4),
                           .normal = vector(i, 6).normalized(),
                           .radius_mm = 1.0 + i % 30,
                           .material = 1});
    SquareLight led;
    led.centre = 400.0 * vector(i, 8);
    led.emits = vector(i, 10).normalized();
    led.u = led.emits.unitOrthogonal();
    led.v = led.emits.cross(led.u);
    led.width_mm = 1.0 + i % 9;
    scene.lights.push_back(led);
  }
  const SceneLights lights(scene, nullptr, 500.0, LightChoice::tree);
  ASSERT_EQ(lights.size(), 903U);
  int n_reach = 0;
  for (std::uint32_t i = 0; i < 40; ++i) {
    const LitPoint at{.point = 500.0 * vector(i, 12), .normal = vector(i, 14).normalized()};
    double sum = 0.0;
    for (std::size_t k = 0; k < lights.size(); ++k) {
      const double probability = lights.probability(k, at);
      sum += probability;
      for (std::uint32_t j = 0; j < 8; ++j) {
        const LightSample found = sample(lights[k], at.point, numbers.two(j, 30));
        if (found.is_found && found.radiance.x() > 0.0 &&
            at.normal.dot(found.direction) > 0.0) {
          ++n_reach;
          EXPECT_GT(probability, 0.0) << i << ' ' << k << ' ' << lights[k].index();
        }
      }
    }
    EXPECT_LE(sum, 1.0 + 1e-9);  // less where both children of a node cannot contribute
  }
  EXPECT_GT(n_reach, 10'000);
}

TEST(Light, PowersAreTheirFlux) {
  // Flux through a closed surface around a light: irradiance on a far sphere.
  const auto flux = [](const Light& light) {
    constexpr double kFar = 1e4;
    const PixelSamples numbers(SamplerKind::sobol, 11, 0, 0);
    double sum = 0.0;
    constexpr std::uint32_t kSamples = 1 << 17;
    for (std::uint32_t i = 0; i < kSamples; ++i) {
      const Vector2d at = numbers.two(i, 0);
      const double z = 2.0 * at.x() - 1.0;
      const double r = std::sqrt(1.0 - z * z);
      const Vector3d out(r * std::cos(2.0 * pi * at.y()), r * std::sin(2.0 * pi * at.y()), z);
      const LightSample found = sample(light, kFar * out, numbers.two(i, 1));
      if (found.is_found) {
        sum += found.radiance.mean() * -out.dot(found.direction) / found.density;
      }
    }
    return sum / kSamples * 4.0 * pi * kFar * kFar;
  };
  const Scene scene = lamps();
  const Vector3d radiance(3, 2, 1);
  SquareLight led;
  led.width_mm = 12;
  led.height_mm = 20;
  led.lobe_mu = 3.5;
  led.radiance = 2.0;
  const std::vector<Light> lights = {
      MeshLight(scene.meshes[1], radiance),
      SphereLight{scene.spheres[0], radiance},
      DiskLight{scene.disks[0], radiance},
      LedLight{led},
      PointSource{{.intensity = radiance}},
      PointSource{{.intensity = radiance, .cos_full = 0.95, .cos_end = 0.7}}};
  // The mesh's two quads: 110 x 70 and 60 x 50 mm.
  EXPECT_NEAR(power(lights[0]), pi * radiance.mean() * (7700.0 + 3000.0), 1e-6);
  for (const Light& light : lights) {
    EXPECT_NEAR(flux(light), power(light), 2e-3 * power(light)) << light.index();
  }
}

}  // namespace
}  // namespace haarlight::render
