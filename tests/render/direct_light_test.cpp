// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/direct_light.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "core/random.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "tests/golden_file.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

SurfacePoint on_plane(double x, double y, const Vector3d& to_eye = Vector3d::UnitZ()) {
  SurfacePoint surface;
  surface.point = {x, y, 0.0};
  surface.normal = surface.flat_normal = Vector3d::UnitZ();
  surface.to_eye = to_eye.normalized();
  return surface;
}

std::vector<SquareLight> led_face(int n, double pitch, double size, double height) {
  std::vector<SquareLight> lights;
  for (int row = 0; row < n; ++row) {
    for (int col = 0; col < n; ++col) {
      SquareLight light;
      light.centre = {(col - 0.5 * (n - 1)) * pitch, (row - 0.5 * (n - 1)) * pitch, height};
      light.width_mm = light.height_mm = size;
      lights.push_back(light);
    }
  }
  return lights;
}

Scene ground() {
  Scene scene;
  scene.materials.emplace_back();
  scene.meshes.push_back(
      make_quad({-1000, -1000, 0}, {1000, -1000, 0}, {1000, 1000, 0}, {-1000, 1000, 0}, 0));
  return scene;
}

TEST(FindLightGrids, FindsFacesAndLoneLights) {
  std::vector<SquareLight> lights = led_face(4, 30.0, 28.0, 900.0);
  SquareLight alone;
  alone.centre = {500, 0, 300};
  lights.push_back(alone);
  for (SquareLight light : led_face(3, 50.0, 28.0, 700.0)) {
    light.u = Vector3d::UnitY();  // another face with turned axes
    light.v = Vector3d::UnitX();
    lights.push_back(light);
  }
  const std::vector<LightGrid> grids = find_light_grids(lights);
  ASSERT_GE(grids.size(), 3U);
  EXPECT_EQ(grids[0].first, 0);
  EXPECT_EQ(grids[0].rows, 4);
  EXPECT_EQ(grids[0].cols, 4);
  EXPECT_EQ(grids[1].rows * grids[1].cols, 1);
  int n_covered = 0;
  for (const LightGrid& grid : grids) {
    EXPECT_EQ(grid.first, n_covered);
    n_covered += grid.rows * grid.cols;
  }
  EXPECT_EQ(n_covered, static_cast<int>(lights.size()));
  EXPECT_TRUE(find_light_grids({}).empty());
}

TEST(DirectLight, UnoccludedLambertEqualsTheClosedForm) {
  const Scene scene = ground();
  const RayCaster caster(scene);
  const std::vector<SquareLight> lights = led_face(8, 30.0, 28.0, 900.0);
  std::vector<LightContribution> contributions(lights.size());
  for (const bool share_tests : {true, false}) {
    const DirectLight direct(caster, lights, {.share_tests = share_tests});
    for (const double x : {0.0, 150.0, -420.0}) {
      const SurfacePoint surface = on_plane(x, 60.0);
      direct.evaluate(surface, scene.materials[0], 1, contributions);
      for (std::size_t k = 0; k < lights.size(); ++k) {
        const double e = light_irradiance(lights[k], surface.point, surface.normal);
        // 2 x 2 Gauss points on a light of 20 mm radius at 900 mm: (20 / 900)^4 / 15.
        EXPECT_NEAR(contributions[k].diffuse, e / std::numbers::pi, 3e-8 * e);
        EXPECT_EQ(contributions[k].visible, 1.0);
      }
    }
  }
}

double number(const nlohmann::json& value) {
  return value.is_string() ? std::stod(value.get<std::string>()) : value.get<double>();
}

TEST(DirectLight, HoldsTheGoldenOccludedLeds) {
  const nlohmann::json golden = test::read_golden("transport.json");
  int n_checked = 0;
  for (const auto& item : golden["cases"]) {
    if (item["kind"] != "square_led_square_occluder_irradiance") {
      continue;
    }
    const auto& geometry = item["geometry"];
    constexpr double kScale = 100.0;  // mm a unit
    const double half = kScale * number(geometry["occluder_half_width"]);
    const double z = kScale * number(geometry["occluder_height"]);
    const double cx = kScale * number(geometry["occluder_centre"][0]);
    const double cy = kScale * number(geometry["occluder_centre"][1]);
    Scene scene;
    scene.materials.emplace_back();
    scene.meshes.push_back(make_quad({cx - half, cy - half, z}, {cx + half, cy - half, z},
                                     {cx + half, cy + half, z}, {cx - half, cy + half, z}, 0));
    const RayCaster caster(scene);
    SquareLight light;
    light.centre = {0, 0, kScale * number(geometry["led_height"])};
    light.width_mm = light.height_mm = 2.0 * kScale * number(geometry["led_half_width"]);
    const SurfacePoint surface = on_plane(kScale * number(geometry["receiver"][0]),
                                          kScale * number(geometry["receiver"][1]));
    std::vector<LightContribution> contribution(1);
    double sum = 0.0;
    double error2 = 0.0;
    constexpr int kRuns = 400;
    const DirectLight direct(caster, {&light, 1});
    for (int run = 0; run < kRuns; ++run) {
      direct.evaluate(surface, scene.materials[0], static_cast<std::uint64_t>(run),
                      contribution);
      sum += contribution[0].diffuse * std::numbers::pi;
      error2 += contribution[0].error * contribution[0].error;
    }
    const double truth = number(item["value_double"]);
    const double unoccluded = light_irradiance(light, surface.point, surface.normal);
    // The keys choose among 64 tables of strata: 64 independent runs. 4.5 standard errors of
    // the stated error, and 1.5e-4 for the offset and for light that varies over the square.
    const double sigma = unoccluded * std::sqrt(error2 / kRuns / 64.0);
    EXPECT_NEAR(sum / kRuns, truth, 4.5 * sigma + 1.5e-4 * truth) << item["id"];
    EXPECT_LT(sigma, 3e-3 * truth);
    ++n_checked;
  }
  EXPECT_EQ(n_checked, 2);
}

/// What a box on a plane leaves of 8 x 8 LEDs around it and on it, all of it `size` times as
/// large and moved.
std::vector<double> around_a_box(double size, const Vector3d& moved) {
  const auto at = [&](double x, double y, double z) -> Vector3d {
    return size * Vector3d(x, y, z) + moved;
  };
  Scene scene;
  scene.materials.emplace_back();
  scene.meshes.push_back(make_quad(at(-1000, -1000, 0), at(1000, -1000, 0), at(1000, 1000, 0),
                                   at(-1000, 1000, 0), 0));
  scene.meshes.push_back(make_box(at(-40, -40, 0), at(40, 40, 60), 0));
  std::vector<SquareLight> lights = led_face(8, 30.0, 28.0, 900.0);
  for (SquareLight& light : lights) {
    light.centre = size * light.centre + moved;
    light.width_mm *= size;
    light.height_mm *= size;
  }
  const RayCaster caster(scene);
  const DirectLight direct(caster, lights);
  std::vector<LightContribution> contributions(lights.size());
  std::vector<double> found;
  std::uint64_t key = 0;
  for (const double gap : {0.02, 0.2, 1.0, 3.0, 10.0}) {  // from the box's walls
    for (const Vector3d& position :
         {Vector3d(40 + gap, 3, 0), Vector3d(-7, 40 + gap, 0), Vector3d(40 - gap, 5, 60)}) {
      SurfacePoint surface = on_plane(0.0, 0.0);
      surface.point = size * position + moved;
      direct.evaluate(surface, scene.materials[0], ++key, contributions);
      for (const LightContribution& contribution : contributions) {
        found.push_back(contribution.diffuse);
      }
    }
  }
  return found;
}

TEST(DirectLight, IsTheSameAtAnySizeAndPosition) {
  const std::vector<double> normal = around_a_box(1.0, Vector3d::Zero());
  const auto n = static_cast<Eigen::Index>(normal.size());
  const Eigen::Map<const Eigen::ArrayXd> truth(normal.data(), n);
  for (const double size : {1e-6, 1e-3, 1.0, 1e3, 1e6}) {
    for (const double far : {0.0, 1e4}) {
      const std::vector<double> found = around_a_box(size, far * size * Vector3d(1, -2, 3));
      const Eigen::Map<const Eigen::ArrayXd> ours(found.data(), n);
      // Of 256 strata of a light that an edge crosses one may fall on the other side.
      const double error = std::sqrt((ours - truth).square().sum() / truth.square().sum());
      EXPECT_LT(error, 3e-4) << "size " << size << ", " << far << " sizes away";
    }
  }
}

TEST(DirectLight, StatedErrorIsTheErrorsSize) {
  // A straight edge over half the light, turned: visible fraction known to be the area's.
  Scene scene;
  scene.materials.emplace_back();
  constexpr double kTurn = 0.4;
  const Vector3d along(std::cos(kTurn), std::sin(kTurn), 0.0);
  const Vector3d across(-std::sin(kTurn), std::cos(kTurn), 0.0);
  const Vector3d z(0, 0, 450.0);
  scene.meshes.push_back(make_quad(z - 300 * along, z + 300 * along,
                                   z + 300 * along + 300 * across,
                                   z - 300 * along + 300 * across, 0));
  const RayCaster caster(scene);
  SquareLight light;
  light.centre = {0, 0, 900};
  light.width_mm = light.height_mm = 28.0;
  std::vector<LightContribution> contribution(1);
  double z2 = 0.0;
  constexpr int kRuns = 64;
  for (std::uint64_t run = 0; run < kRuns; ++run) {
    const DirectLight direct(caster, {&light, 1}, {.seed = run});
    direct.evaluate(on_plane(0, 0), scene.materials[0], run, contribution);
    const double deviation = (contribution[0].visible - 0.5) / contribution[0].error;
    z2 += deviation * deviation;
  }
  // The squares' mean is 1 when the stated error is right; chi-square with 64 degrees, and a
  // factor of 1.5 either way for the "1/6 a cut stratum" model.
  EXPECT_GT(z2 / kRuns, 0.3);
  EXPECT_LT(z2 / kRuns, 2.0);
}

// Four lights chosen from an array: a regular grid, but with far more gap than light. A shadow's
// edge that crosses one of them passes between the corners of its cell and its centre.
TEST(DirectLight, LightsThatStandApartHavePenumbrae) {
  const std::vector<SquareLight> lights = led_face(2, 570.0, 28.0, 900.0);
  // At a tenth of the way this square covers 30 % of the light at (285, 285): x from 27.1 to
  // 27.94 of 27.1 to 29.9, and all of it in y.
  Scene scene;
  scene.materials.emplace_back();
  scene.meshes.push_back(make_quad({20.0, 20.0, 90.0}, {27.94, 20.0, 90.0}, {27.94, 40.0, 90.0},
                                   {20.0, 40.0, 90.0}, 0));
  const RayCaster caster(scene);
  const DirectLight direct(caster, lights);
  std::vector<LightContribution> contributions(lights.size());
  direct.evaluate(on_plane(0, 0), scene.materials[0], 1, contributions);
  for (std::size_t k = 0; k < lights.size(); ++k) {
    const bool is_crossed = lights[k].centre.x() > 0.0 && lights[k].centre.y() > 0.0;
    // One stratum's width at most: the edge runs along a column of 16 x 16 strata.
    EXPECT_NEAR(contributions[k].visible, is_crossed ? 0.7 : 1.0,
                is_crossed ? 1.0 / 16.0 : 0.0);
  }
}

TEST(DirectLight, SharedTestsFindWhatSeparateTestsFind) {
  Scene scene = ground();
  scene.meshes.push_back(make_sphere({30, 10, 80}, 40.0, 4, 0));
  scene.meshes.push_back(make_box({-90, -60, 0}, {-60, 60, 110}, 0));
  const RayCaster caster(scene);
  const std::vector<SquareLight> lights = led_face(32, 30.0, 28.0, 900.0);
  const DirectLight shared(caster, lights, {.share_tests = true});
  const DirectLight separate(caster, lights, {.share_tests = false});
  std::vector<LightContribution> a(lights.size());
  std::vector<LightContribution> b(lights.size());
  double difference2 = 0.0;
  double norm2 = 0.0;
  std::uint64_t rays_shared = 0;
  std::uint64_t rays_separate = 0;
  for (int i = 0; i < 60; ++i) {
    const auto key = static_cast<std::uint64_t>(i);
    const SurfacePoint surface = on_plane(300.0 * (uniform_unit(hash_key(1, key)) - 0.5),
                                          300.0 * (uniform_unit(hash_key(2, key)) - 0.5));
    rays_shared += shared.evaluate(surface, scene.materials[0], key, a);
    rays_separate += separate.evaluate(surface, scene.materials[0], key, b);
    for (std::size_t k = 0; k < lights.size(); ++k) {
      difference2 += std::pow(a[k].diffuse - b[k].diffuse, 2);
      norm2 += std::pow(b[k].diffuse, 2);
    }
  }
  // Where both sample a light they use the same strata; what is left are lights one of them
  // took for uniform.
  EXPECT_LT(std::sqrt(difference2 / norm2), 1e-3);
  EXPECT_LT(2 * rays_shared, rays_separate);
}

TEST(DirectLight, GlossyLobeEqualsFineQuadrature) {
  const Scene scene = ground();
  const RayCaster caster(scene);
  const std::vector<SquareLight> lights = led_face(4, 30.0, 28.0, 900.0);
  std::vector<LightContribution> contributions(lights.size());
  const DirectLight direct(caster, lights);
  const SurfacePoint surface = on_plane(20.0, -30.0, Vector3d(-0.1, 0.05, 1.0));
  for (const double exponent : {1.0, 60.0, 200.0, 5000.0}) {
    const Material material{"", Vector3d::Zero(), 1.0, exponent};
    direct.evaluate(surface, material, 1, contributions);
    for (std::size_t k = 0; k < lights.size(); ++k) {
      constexpr int kCells = 200;
      double sum = 0.0;
      for (int i = 0; i < kCells * kCells; ++i) {
        const int row = i / kCells;
        const int col = i % kCells;
        const Vector3d p = lights[k].centre + Vector3d(28.0 * ((col + 0.5) / kCells - 0.5),
                                                       28.0 * ((row + 0.5) / kCells - 0.5), 0);
        const Vector3d r = p - surface.point;
        const Vector3d half = (r.normalized() + surface.to_eye).normalized();
        const double cos_theta = r.normalized().z();
        sum += (exponent + 8.0) / (8.0 * std::numbers::pi) * std::pow(half.z(), exponent) *
               cos_theta * cos_theta / r.squaredNorm();
      }
      const double truth = sum * 28.0 * 28.0 / (kCells * kCells);
      // Against the largest light: the switch-overs are set for 1e-4 of it.
      EXPECT_NEAR(contributions[k].specular, truth, 1e-4 * truth + 1e-12)
          << exponent << ' ' << k;
    }
  }
}

TEST(DirectLight, NothingComesFromBehindOrBelow) {
  Scene scene;
  scene.materials.emplace_back();
  const RayCaster caster(scene);
  std::vector<SquareLight> lights(2);
  lights[0].centre = {0, 0, 100};
  lights[0].emits = Vector3d::UnitZ();  // away
  lights[1].centre = {0, 0, -100};
  lights[1].emits = Vector3d::UnitZ();  // towards, but below the horizon
  std::vector<LightContribution> contributions(2);
  const DirectLight direct(caster, lights);
  direct.evaluate(on_plane(0, 0), scene.materials[0], 1, contributions);
  EXPECT_EQ(contributions[0].diffuse, 0.0);
  EXPECT_EQ(contributions[1].diffuse, 0.0);
}

TEST(DirectLight, ALightCutByTheHorizonEqualsTheClosedForm) {
  Scene scene;
  scene.materials.emplace_back();
  const RayCaster caster(scene);
  SquareLight light;
  light.centre = {200, 0, 10};
  light.u = Vector3d::UnitY();
  light.v = Vector3d::UnitZ();
  light.emits = -Vector3d::UnitX();
  light.width_mm = light.height_mm = 60.0;  // z from -20 to 40
  std::vector<LightContribution> contribution(1);
  double sum = 0.0;
  const DirectLight direct(caster, {&light, 1});
  for (std::uint64_t key = 0; key < 200; ++key) {
    direct.evaluate(on_plane(0, 0), scene.materials[0], key, contribution);
    sum += contribution[0].diffuse;
  }
  const double e = light_irradiance(light, Vector3d::Zero(), Vector3d::UnitZ());
  // Strata of 1/16 with a kink at the horizon: 1e-3 each run, 64 tables.
  EXPECT_NEAR(sum / 200, e / std::numbers::pi, 5e-4 * e);
}

}  // namespace
}  // namespace haarlight::render
