// SPDX-License-Identifier: Apache-2.0
/// @file
/// Bidirectional path tracing beside path tracing: all strategies together, and each alone.
///
/// Means over a picture are compared by Student's t of 16 replicates each. Its degrees of freedom are
/// taken as 15, as if one of the two variances were all: |t| > 5.24 has a probability of 0.0001, so that
/// of the 100 comparisons here one in 100 runs with other seeds would raise a false alarm. The seeds are fixed.

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "render/surface/bidirectional_integrator.h"
#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"
#include "tests/render/surface/bidirectional_scenes.h"
#include "tests/render/surface/square_camera.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using testing::kBidirectionalSize;
using testing::mean_of_bidirectional;
using testing::mean_of_paths;
using testing::mean_of_paths_of;
using testing::PictureMean;
using testing::Rendering;

constexpr double kMostT = 5.24;

/// @param weak  a standard error of the difference beyond that, of the mean, would see nothing
void expect_same(const PictureMean& found, const PictureMean& truth, double weak,
                 const std::string& name) {
  for (int c = 0; c < 3; ++c) {
    const double sigma = std::hypot(found.error[c], truth.error[c]);
    const double off = found.value[c] - truth.value[c];
    if (c == 1) {
      fmt::print("{:46s} {:.6g} and {:.6g}: off {:+.3f} %, sigma {:.3f} %, t {:+.2f}\n", name,
                 found.value[c], truth.value[c], 100.0 * off / truth.value[c],
                 100.0 * sigma / truth.value[c], off / std::max(sigma, 1e-300));
    }
    EXPECT_LE(sigma, weak * truth.value[c]) << name << ": weak";
    // Single precision of pictures; offsets of rays.
    EXPECT_LE(std::abs(off), kMostT * sigma + 1e-5 * truth.value[c])
        << name << ", colour " << c;
  }
}

TEST(Bidirectional, EachStrategyAloneFindsAllPathsOfItsLength) {
  const Scene scene = testing::room();
  Rendering rendering{.scene = &scene, .model = testing::room_camera()};
  for (int bounces = 1; bounces <= 3; ++bounces) {
    rendering.samples = 64;
    const PictureMean truth = mean_of_paths_of(rendering, {}, bounces);
    const int n_vertices = bounces + 2;
    for (int s = 0; s < n_vertices; ++s) {
      BidirectionalOptions options;
      options.most_bounces = bounces;
      options.only = PathStrategy{s, n_vertices - s};
      rendering.samples = s == 0 ? 128 : 32;
      expect_same(mean_of_bidirectional(rendering, options), truth, 0.025 * bounces,
                  fmt::format("s = {}, t = {}", s, n_vertices - s));
    }
  }
}

TEST(Bidirectional, AllStrategiesTogetherArePathTracing) {
  const Scene scene = testing::room();
  const Rendering rendering{.scene = &scene, .model = testing::room_camera()};
  expect_same(mean_of_bidirectional(rendering, {}), mean_of_paths(rendering, {}), 0.012,
              "room");
  const Rendering lens{.scene = &scene,
                       .model = testing::room_camera(),
                       .optics = {.lens_radius_mm = 30.0, .focus_mm = 500.0}};
  expect_same(mean_of_bidirectional(lens, {}), mean_of_paths(lens, {}), 0.012, "a lens");
  Rendering distorted = rendering;
  distorted.model.distortion << -0.3, 0.1, 0.01, -0.02, 0.0;
  expect_same(mean_of_bidirectional(distorted, {}), mean_of_paths(distorted, {}), 0.012,
              "distorted");
  Rendering parallel = rendering;
  parallel.optics.pixel_mm = 15.0;
  expect_same(mean_of_bidirectional(parallel, {}), mean_of_paths(parallel, {}), 0.012,
              "orthographic");
  Rendering near = rendering;
  near.optics.near_mm = 560.0;
  near.optics.far_mm = 720.0;
  expect_same(mean_of_bidirectional(near, {}), mean_of_paths(near, {}), 0.012, "near and far");
  for (const FilterKind filter : {FilterKind::gaussian, FilterKind::mitchell}) {
    BidirectionalOptions options;
    options.filter = filter;
    PathOptions path;
    path.filter = filter;
    expect_same(mean_of_bidirectional(rendering, options), mean_of_paths(rendering, path), 0.02,
                std::string(to_string(filter)));
  }
}

/// Splats alone: each camera's importance, and where it puts what it sees.
TEST(Bidirectional, LightTracingAloneIsPathTracingInEveryCamera) {
  const Scene scene = testing::room();
  BidirectionalOptions options;
  options.most_bounces = 1;
  options.only = PathStrategy{2, 1};
  PathOptions path;
  Rendering rendering{.scene = &scene, .model = testing::room_camera()};
  const auto compare = [&](const std::string& name) {
    rendering.samples = 64;
    const PictureMean truth = mean_of_paths_of(rendering, path, 1);
    expect_same(mean_of_bidirectional(rendering, options), truth, 0.05, name);
  };
  compare("pinhole");
  rendering.optics = {.lens_radius_mm = 30.0, .focus_mm = 500.0};
  compare("lens");
  rendering.model.distortion << -0.3, 0.1, 0.01, -0.02, 0.0;
  compare("distorted lens");
  rendering.optics = {.near_mm = 560.0, .far_mm = 720.0};
  compare("distorted, near and far");
  for (const FilterKind filter : {FilterKind::gaussian, FilterKind::mitchell}) {
    options.filter = filter;
    path.filter = filter;
    compare(std::string(to_string(filter)));
  }
}

/// Light of every kind, by light tracing alone where it leaves the light, and by all strategies.
TEST(Bidirectional, LightOfEveryKindLeavesAsItArrives) {
  struct Lamp {
    std::string name;
    void (*add)(Scene& scene);
  };
  const std::vector<Lamp> lamps = {
      {"mesh",
       [](Scene& scene) {
         scene.meshes.push_back(
             make_quad({-50, -60, 290}, {-50, 60, 290}, {60, 60, 290}, {60, -60, 290}, 0));
       }},
      {"sphere",
       [](Scene& scene) {
         scene.spheres.push_back({.centre = {20, 10, 220}, .radius_mm = 40, .material = 0});
       }},
      {"disk",
       [](Scene& scene) {
         scene.disks.push_back({.centre = {30, -40, 250},
                                .normal = Vector3d(0.6, 0.0, -0.8),
                                .radius_mm = 40,
                                .material = 0});
       }},
      {"LED",
       [](Scene& scene) {
         scene.lights.push_back({.centre = {10, -20, 280},
                                 .width_mm = 60,
                                 .height_mm = 30,
                                 .radiance = 8,
                                 .lobe_mu = 3});
       }},
      {"point",
       [](Scene& scene) {
         scene.point_lights.push_back(
             {.position = {-30, -80, 200}, .intensity = Vector3d(3e4, 2e4, 1e4)});
       }},
      {"spot",
       [](Scene& scene) {
         scene.point_lights.push_back({.position = {-30, -80, 280},
                                       .intensity = Vector3d(9e4, 8e4, 7e4),
                                       .axis = Vector3d(0.2, 0.3, -1.0).normalized(),
                                       .cos_full = 0.95,
                                       .cos_end = 0.8});
       }},
      {"from afar",
       [](Scene& scene) {
         scene.directional_lights.push_back({.direction = Vector3d(0.3, 0.4, -0.8).normalized(),
                                             .irradiance = Vector3d(3, 2, 1)});
       }},
      {"environment", [](Scene& scene) { scene.environment = EnvironmentSource{}; }},
      {"mesh and point, of 1000 times the power", [](Scene& scene) {
         scene.meshes.push_back(
             make_quad({-50, -60, 290}, {-50, 60, 290}, {60, 60, 290}, {60, -60, 290}, 0));
         scene.point_lights.push_back(
             {.position = {-30, -80, 200}, .intensity = Vector3d(4e7, 3e7, 2e7)});
       }}};
  Image<float> sky(8, 16, 3);
  for (std::size_t i = 0; i < sky.pixels().size(); ++i) {
    sky.pixels()[i] = static_cast<float>(0.2 + 0.1 * static_cast<double>(i % 11));
  }
  sky(2, 5) = 60.0F;
  const Environment environment = Environment::from_picture(sky, "made");
  for (const Lamp& lamp : lamps) {
    Scene scene = testing::room();
    scene.meshes.erase(scene.meshes.begin() + 4);  // its own lamp
    lamp.add(scene);
    Rendering rendering{.scene = &scene,
                        .model = testing::room_camera(),
                        .environment = scene.environment ? &environment : nullptr};
    const PictureMean truth = mean_of_paths_of(rendering, {}, 1);
    BidirectionalOptions options;
    options.most_bounces = 1;
    options.only = PathStrategy{2, 1};
    expect_same(mean_of_bidirectional(rendering, options), truth, 0.03, lamp.name + ", (2, 1)");
    expect_same(mean_of_bidirectional(rendering, {}), mean_of_paths(rendering, {}), 0.02,
                lamp.name + ", all");
  }
}

/// A floor of light under a ball of glass and a mirror: s = 0 alone finds what the camera sees in the
/// ball, and the lights' paths what they focus.
TEST(Bidirectional, GlassAndMirrorsAreThoseOfPaths) {
  Scene scene = testing::room();
  scene.materials.push_back({.name = "glass", .bsdf = BsdfKind::dielectric, .ior = 1.5});
  scene.materials.push_back(
      {.name = "mirror", .bsdf = BsdfKind::mirror, .reflectance = Vector3d(0.9, 0.8, 0.7)});
  const int glass = static_cast<int>(scene.materials.size()) - 2;
  scene.meshes.resize(5);
  scene.spheres.push_back({.centre = {70, 0, 70}, .radius_mm = 60, .material = glass});
  scene.spheres.push_back({.centre = {-80, 60, 80}, .radius_mm = 60, .material = glass + 1});
  const Rendering rendering{.scene = &scene, .model = testing::room_camera(), .samples = 128};
  expect_same(mean_of_bidirectional(rendering, {}), mean_of_paths(rendering, {}), 0.02, "all");
}

/// A matte square and the camera within a block of glass, a lamp before it: what enters has n^2 of the
/// radiance, and a light's path all of its flux but what Fresnel's equations reflect.
TEST(Bidirectional, GlassIsEnteredByFluxAndSeenByRadiance) {
  Scene scene;
  scene.materials = {{.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d(3, 2, 1)},
                     {.name = "glass", .bsdf = BsdfKind::dielectric, .ior = 1.6},
                     {.name = "paper", .kd = Vector3d::Constant(0.8)}};
  scene.meshes.push_back(
      make_quad({-150, -150, 200}, {-150, 150, 200}, {150, 150, 200}, {150, -150, 200}, 0));
  scene.meshes.push_back(make_box({-150, -140, -50}, {150, 160, 80}, 1));
  scene.meshes.push_back(make_quad({-50, -50, 0}, {50, -50, 0}, {50, 50, 0}, {-50, 50, 0}, 2));
  Rendering rendering{
      .scene = &scene,
      .model = testing::square_camera({0, -40, 60}, {0, 0, 0}, 40.0, kBidirectionalSize),
      .samples = 128};
  const PictureMean truth = mean_of_paths_of(rendering, {}, 2);
  for (const PathStrategy& strategy : {PathStrategy{3, 1}, PathStrategy{0, 4}}) {
    BidirectionalOptions options;
    options.most_bounces = 2;
    options.only = strategy;
    expect_same(mean_of_bidirectional(rendering, options), truth, 0.03,
                fmt::format("({}, {})", strategy.light_vertices, strategy.camera_vertices));
  }
  expect_same(mean_of_bidirectional(rendering, {}), mean_of_paths(rendering, {}), 0.01, "all");
}

TEST(Bidirectional, AFurnaceShowsTheSameInAllDirections) {
  for (const double albedo : {0.5, 0.9}) {
    Scene scene;
    scene.materials.push_back(
        {.name = "wall", .kd = Vector3d::Constant(albedo), .emits = Vector3d::Constant(2.0)});
    Mesh box = make_box({-300, -300, -300}, {300, 300, 300}, 0);
    for (Eigen::Vector3i& triangle : box.triangles) {
      std::swap(triangle[1], triangle[2]);
    }
    scene.meshes.push_back(box);
    scene.materials.push_back({.name = "glass", .bsdf = BsdfKind::dielectric, .ior = 1.5});
    scene.spheres.push_back({.centre = {0, 0, 0}, .radius_mm = 100, .material = 1});
    for (const Vector3d& eye : {Vector3d(20, -250, 60), Vector3d(1, 2, 3)}) {
      const Rendering rendering{
          .scene = &scene,
          .model = testing::square_camera(eye, {80, 10, 20}, 16.0, kBidirectionalSize),
          .samples = 32};
      BidirectionalOptions options;
      options.most_bounces = 200;
      const bool is_within = eye.norm() < 100.0;  // L/n^2 is the same everywhere
      PictureMean truth;
      truth.value.setConstant(2.0 / (1.0 - albedo) * (is_within ? 1.5 * 1.5 : 1.0));
      expect_same(
          mean_of_bidirectional(rendering, options), truth, 0.012,
          fmt::format("albedo {}, {}", albedo, is_within ? "within glass" : "before it"));
    }
  }
}

/// The same film for any number of passes, and in parts.
TEST(Bidirectional, TheSameForAnyPassesAndParts) {
  const Scene scene = testing::room();
  const RayCaster caster(scene);
  CameraModel model = testing::square_camera({20, -600, 180}, {0, 0, 120}, 70.0, 70);
  const BidirectionalIntegrator integrator(scene, caster, nullptr, model,
                                           {.width = 70, .height = 70});
  const auto film = [] { return Film(70, 70, surface_layers(false, true)); };
  Film once = film();
  static_cast<void>(run(integrator, {.samples = 7}, once));
  Film often = film();
  for (std::uint32_t n = 1; n <= 7; n += 2) {
    static_cast<void>(run(integrator, {.samples = n}, often));
  }
  Film joined = film();
  for (std::size_t part = 0; part < 3; ++part) {
    Film own = film();
    static_cast<void>(run(integrator, {.samples = 7, .part = {part, 3}}, own));
    for (std::size_t i = part; i < own.n_tiles(); i += 3) {
      joined.put(i, own.take(i));
    }
    joined.add_splats(own.state().splats);
  }
  const Image<float> mean = once.mean(0);
  const Image<float> error = once.standard_error(0);
  for (const Film* other : {&often, &joined}) {
    EXPECT_TRUE(std::ranges::equal(mean.pixels(), other->mean(0).pixels()));
    EXPECT_TRUE(std::ranges::equal(error.pixels(), other->standard_error(0).pixels()));
  }
  EXPECT_GT(std::ranges::max(mean.pixels()), 0.0F);
}

/// What it tells of path tracing, summed over the picture: squares, and light that is never met.
Vector2d told_of_paths(const Rendering& rendering) {
  const int side = rendering.model.width;
  const RayCaster caster(*rendering.scene);
  const BidirectionalIntegrator integrator(
      *rendering.scene, caster, rendering.environment, rendering.model,
      {.width = side, .height = side, .tells_of_path_tracing = true});
  Film film(side, side, surface_layers(false, true, true));
  static_cast<void>(run(integrator, {.samples = rendering.samples}, film));
  const Image<float> told = film.mean(SurfaceLayer::path_tracing(false));
  Vector2d sum = Vector2d::Zero();
  for (std::size_t i = 0; i < told.pixels().size(); ++i) {
    sum[static_cast<Eigen::Index>(i % 2)] += double{told.pixels()[i]};
  }
  return sum;
}

/// The squares of its samples, summed over pixels and colours: of the mean, and variance.
double squares_of_paths(const Rendering& rendering, const PathOptions& options) {
  const int side = rendering.model.width;
  const RayCaster caster(*rendering.scene);
  const PathIntegrator integrator(*rendering.scene, caster, rendering.environment,
                                  rendering.model, options);
  Film film(side, side, surface_layers(false));
  static_cast<void>(run(integrator, {.samples = rendering.samples}, film));
  const Image<float> mean = film.mean(0);
  const Image<float> error = film.standard_error(0);
  double sum = 0.0;
  for (std::size_t i = 0; i < mean.pixels().size(); ++i) {
    sum += std::pow(double{mean.pixels()[i]}, 2) +
           rendering.samples * std::pow(double{error.pixels()[i]}, 2);
  }
  return sum;
}

/// Told squares over those of path tracing's own samples: 1/sqrt(2) of light that is found in one way; of two
/// up to 1, less what several vertices of a path find at once.
TEST(Bidirectional, TellsTheSquaresOfPathTracing) {
  const PathOptions independent{.sampler = SamplerKind::independent};
  // A floor under a lamp, one bounce.
  Scene floor = testing::room();
  floor.meshes = {floor.meshes[0], floor.meshes[4]};
  Rendering rendering{.scene = &floor, .model = testing::room_camera(), .samples = 1024};
  const double direct = told_of_paths(rendering).x() / squares_of_paths(rendering, independent);
  // All ways and bounces.
  const Scene room = testing::room();
  rendering.scene = &room;
  const double all = told_of_paths(rendering).x() / squares_of_paths(rendering, independent);
  // A caustic alone: the room's light by way of a ball of glass about a lamp.
  Scene caustic = floor;
  caustic.materials.push_back({.name = "glass", .bsdf = BsdfKind::dielectric, .ior = 1.5});
  caustic.meshes.pop_back();
  const int glass = static_cast<int>(caustic.materials.size()) - 1;
  caustic.spheres.push_back({.centre = {0, 0, 400}, .radius_mm = 80, .material = glass});
  caustic.spheres.push_back({.centre = {0, 0, 400}, .radius_mm = 30, .material = 0});
  rendering.scene = &caustic;
  rendering.samples = 16384;
  const double chance = told_of_paths(rendering).x() / squares_of_paths(rendering, independent);
  fmt::print("told / own squares: direct {:.3f}, all {:.3f}, by chance {:.3f}\n", direct, all,
             chance);
  // Other seeds: within 0.002.
  EXPECT_NEAR(direct, 1.0 / std::numbers::sqrt2, 0.02);
  EXPECT_NEAR(all, 0.69, 0.015);
  EXPECT_NEAR(chance, 1.0 / std::numbers::sqrt2, 0.02);
}

/// A point lamp in a ball of glass lights the floor by way of the glass alone.
TEST(Bidirectional, TellsOfLightThatPathTracingNeverMeets) {
  Scene scene = testing::room();
  scene.meshes = {scene.meshes[0]};
  scene.materials.push_back({.name = "glass", .bsdf = BsdfKind::dielectric, .ior = 1.5});
  const int glass = static_cast<int>(scene.materials.size()) - 1;
  scene.spheres.push_back({.centre = {0, 0, 400}, .radius_mm = 80, .material = glass});
  scene.point_lights.push_back(
      {.position = {10, 0, 400}, .intensity = Vector3d::Constant(1e5)});
  const Rendering rendering{.scene = &scene, .model = testing::room_camera(), .samples = 512};
  EXPECT_EQ(mean_of_paths(rendering, {}).value.sum(), 0.0);
  const double light = mean_of_bidirectional(rendering, {}).value.sum() * kBidirectionalSize *
                       kBidirectionalSize;
  ASSERT_GT(light, 0.0);
  const Vector2d told = told_of_paths(rendering);
  EXPECT_NEAR(told.y() / light, 1.0, 0.1);
  EXPECT_EQ(told.x(), 0.0);
  // And an open lamp has none.
  const Scene room = testing::room();
  EXPECT_EQ(told_of_paths({.scene = &room, .model = testing::room_camera()}).y(), 0.0);
}

/// The root of the mean squared stated error over what pictures of other seeds differ by.
double stated_over_true_error(const BidirectionalOptions& asked) {
  const Scene scene = testing::room();
  const RayCaster caster(scene);
  constexpr int kPictures = 24;
  const std::size_t n = std::size_t{3} * kBidirectionalSize * kBidirectionalSize;
  std::vector<double> sums(n);
  std::vector<double> squares(n);
  double stated = 0.0;
  for (int i = 0; i < kPictures; ++i) {
    BidirectionalOptions options = asked;
    options.sampler = SamplerKind::independent;
    options.seed = static_cast<std::uint64_t>(i);
    options.width = options.height = kBidirectionalSize;
    const BidirectionalIntegrator integrator(scene, caster, nullptr, testing::room_camera(),
                                             options);
    Film film(kBidirectionalSize, kBidirectionalSize, surface_layers(false, true));
    static_cast<void>(run(integrator, {.samples = 32}, film));
    const Image<float> mean = film.mean(0);
    const Image<float> error = film.standard_error(0);
    for (std::size_t j = 0; j < n; ++j) {
      const double value = mean.pixels()[j];
      sums[j] += value;
      squares[j] += value * value;
      stated += std::pow(double{error.pixels()[j]}, 2) / kPictures;
    }
  }
  double true_squared = 0.0;
  for (std::size_t j = 0; j < n; ++j) {
    true_squared += (squares[j] - sums[j] * sums[j] / kPictures) / (kPictures - 1);
  }
  return std::sqrt(stated / true_squared);
}

/// 768 values of 23 degrees of freedom each, not all independent: 3 % or less by chance.
TEST(Bidirectional, StatesItsErrorWithThatOfSplats) {
  const double all = stated_over_true_error({});
  const double splats = stated_over_true_error({.most_bounces = 1, .only = PathStrategy{2, 1}});
  fmt::print("stated / true error {:.3f}, of splats alone {:.3f}\n", all, splats);
  EXPECT_NEAR(all, 1.0, 0.1);
  EXPECT_NEAR(splats, 1.0, 0.1);
}

}  // namespace
}  // namespace haarlight::render
