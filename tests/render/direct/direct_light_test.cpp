// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/direct/direct_light.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "core/random.h"
#include "haarlight/core/error.h"
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
  const DirectLight direct(caster, lights);
  for (const double x : {0.0, 150.0, -420.0}) {
    const SurfacePoint surface = on_plane(x, 60.0);
    // Nothing stands between: one ray tells for all.
    EXPECT_EQ(direct.evaluate(surface, scene.materials[0], 1, contributions), 1U);
    for (std::size_t k = 0; k < lights.size(); ++k) {
      const double e = light_irradiance(lights[k], surface.point, surface.normal);
      // 2 x 2 Gauss points on a light of 20 mm radius at 900 mm: (20 / 900)^4 / 15.
      EXPECT_NEAR(contributions[k].diffuse, e / std::numbers::pi, 3e-8 * e);
      EXPECT_EQ(contributions[k].visible, 1.0);
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

// ---- against the definition: every light by all strata ----

/// LEDs of 28 mm around the origin, which they face.
std::vector<SquareLight> dome(int n) {
  std::vector<SquareLight> lights;
  for (int k = 0; k < n; ++k) {
    const double z = 0.2 + 0.79 * (k + 0.5) / n;
    const double turn = 2.399963 * k;
    SquareLight light;
    const Vector3d out(std::sqrt(1 - z * z) * std::cos(turn),
                       std::sqrt(1 - z * z) * std::sin(turn), z);
    light.centre = 900.0 * out;
    light.u = Vector3d(-std::sin(turn), std::cos(turn), 0.0);
    light.v = light.u.cross(out);
    light.emits = -out;
    light.width_mm = light.height_mm = 28.0;
    lights.push_back(light);
  }
  return lights;
}

struct Compared {
  double largest = 0.0;  ///< |difference| of a visible fraction
  int n_differ = 0;
  int n_penumbra = 0;
  std::uint64_t n_rays = 0;
  std::uint64_t n_rays_defined = 0;
};

/// At points that the camera above sees.
Compared compare(const Scene& scene, const std::vector<SquareLight>& lights, int n_points) {
  const RayCaster caster(scene);
  const DirectLight direct(caster, lights);
  const DirectLight defined(caster, lights, {.sample_all = true});
  std::vector<LightContribution> a(lights.size());
  std::vector<LightContribution> b(lights.size());
  Compared found;
  for (int i = 0; i < n_points; ++i) {
    const auto key = static_cast<std::uint64_t>(i);
    const Vector3d eye(0, -560, 520);
    const Vector3d target(300.0 * (uniform_unit(hash_key(1, key)) - 0.5),
                          300.0 * (uniform_unit(hash_key(2, key)) - 0.5),
                          60.0 * uniform_unit(hash_key(3, key)));
    const auto hit = caster.intersect(eye, (target - eye).normalized());
    if (!hit) {
      continue;
    }
    const SurfacePoint surface{hit->point, hit->normal, hit->flat_normal,
                               (eye - hit->point).normalized(), 0};
    found.n_rays += direct.evaluate(surface, scene.materials[0], key, a);
    found.n_rays_defined += defined.evaluate(surface, scene.materials[0], key, b);
    for (std::size_t k = 0; k < lights.size(); ++k) {
      const double difference = std::abs(a[k].visible - b[k].visible);
      found.largest = std::max(found.largest, difference);
      found.n_differ += difference > 0.0;
      found.n_penumbra += b[k].visible > 0.0 && b[k].visible < 1.0;
    }
  }
  return found;
}

Scene ball_and_box() {
  Scene scene = ground();
  scene.meshes.push_back(make_sphere({30, 10, 80}, 40.0, 4, 0));
  scene.meshes.push_back(make_box({-90, -60, 0}, {-60, 60, 110}, 0));
  return scene;
}

/// Triangles through each other, wound either way, some of them sharing edges by threes.
Scene soup(std::uint64_t seed) {
  Scene scene = ground();
  Mesh mesh;
  const auto pick = [&](std::uint64_t i, double low, double high) {
    return low + (high - low) * uniform_unit(hash_key(seed, i));
  };
  for (std::uint64_t i = 0; i < 40; ++i) {
    mesh.vertices.emplace_back(pick(3 * i, -120, 120), pick(3 * i + 1, -120, 120),
                               pick(3 * i + 2, 5, 200));
  }
  for (std::uint64_t i = 0; i < 60; ++i) {
    const auto vertex = [&](std::uint64_t c) {
      return static_cast<int>(pick(1000 + 3 * i + c, 0.0, 39.999));
    };
    mesh.triangles.emplace_back(vertex(0), vertex(1), vertex(2));
  }
  scene.meshes.push_back(mesh);
  return scene;
}

// Where both sample a stratum they use the same point of it, and elsewhere nothing can part the
// strata: the fractions are equal but for rounding, by which an edge may pass a sample's point
// on the other side, in one stratum of 256.
constexpr double kOneStratum = 1.0 / 256.0;

TEST(DirectLight, SeesWhatTheDefinitionSees) {
  for (const Scene& scene : {ball_and_box(), soup(1), soup(2), soup(3)}) {
    for (const std::vector<SquareLight>& lights :
         {led_face(32, 30.0, 28.0, 900.0), led_face(8, 120.0, 28.0, 900.0), dome(60)}) {
      const Compared found = compare(scene, lights, 20);
      EXPECT_LE(found.largest, kOneStratum);
      EXPECT_LE(found.n_differ, 2);
      EXPECT_GT(found.n_penumbra, 10);
      EXPECT_LT(10 * found.n_rays, found.n_rays_defined);
    }
  }
}

TEST(DirectLight, SeesWhatTheDefinitionSeesThroughGeometryAtTheLights) {
  // Two faces at right angles; a wall through one face, a plate in its plane that hides
  // nothing, and screens that end at the lights or between them and where rays end.
  std::vector<SquareLight> lights = led_face(8, 60.0, 28.0, 400.0);
  for (SquareLight light : led_face(8, 60.0, 28.0, 0.0)) {
    light.centre = Vector3d(400.0, light.centre.x(), light.centre.y() + 250.0);
    light.u = Vector3d::UnitY();
    light.v = Vector3d::UnitZ();
    light.emits = -Vector3d::UnitX();
    lights.push_back(light);
  }
  Scene scene = ball_and_box();
  const auto wall = [&](double x, double low, double high) {
    scene.meshes.push_back(
        make_quad({x, -300, low}, {x + 30, 300, low}, {x + 30, 300, high}, {x, -300, high}, 0));
  };
  wall(-100.0, 300.0, 500.0);
  wall(35.0, 380.0, 400.0);
  wall(95.0, 350.0, 399.999);
  scene.meshes.push_back(
      make_quad({100, 100, 400}, {250, 100, 400}, {250, 250, 400}, {100, 250, 400}, 0));
  scene.meshes.push_back(
      make_quad({380, -90, 100}, {410, -90, 160}, {410, 90, 160}, {380, 90, 100}, 0));
  const Compared found = compare(scene, lights, 60);
  EXPECT_LE(found.largest, kOneStratum);
  EXPECT_LE(found.n_differ, 2);
  EXPECT_GT(found.n_penumbra, 100);
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

TEST(DirectLight, RefusesMaterialsThatItDoesNotKnowByName) {
  Scene scene;
  scene.materials = {{.name = "matte"}};
  require_for_direct_light(scene, "s.toml", "a program");
  scene.materials.push_back({.name = "glass", .bsdf = BsdfKind::dielectric});
  try {
    require_for_direct_light(scene, "s.toml", "a program");
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(
        error.problem(),
        "material 'glass' has bsdf = \"dielectric\"; a program renders \"blinn_phong\" only");
    EXPECT_EQ(error.where(), "s.toml");
  }
  scene.materials.back() = {.name = "tiles", .kd_texture = {.file = "tiles.png"}};
  try {
    require_for_direct_light(scene, "s.toml", "a program");
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.problem(),
              "material 'tiles' has a texture; a program renders plain colours only");
    EXPECT_EQ(error.where(), "s.toml");
    EXPECT_FALSE(error.hint().empty());
  }
  scene.materials.pop_back();
  scene.spheres.emplace_back();
  EXPECT_THROW(require_for_direct_light(scene, "s.toml", "a program"), Error);
  scene.spheres.clear();
  scene.disks.emplace_back();
  EXPECT_THROW(require_for_direct_light(scene, "s.toml", "a program"), Error);
}

}  // namespace
}  // namespace haarlight::render
