// SPDX-License-Identifier: Apache-2.0
/// @file
/// Path tracing's baselines: a new path for each number of bounces, and vertices drawn by area.

#include "render/surface/path_baselines.h"

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <numbers>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"
#include "tests/render/surface/square_camera.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using std::numbers::pi;

constexpr int kSize = 16;

struct Picture {
  Image<float> mean;
  Image<float> error;
};
Picture render(const TileRenderer& integrator, std::uint32_t samples) {
  Film film(kSize, kSize, surface_layers(false));
  EXPECT_EQ(run(integrator, {.samples = samples}, film).samples, samples);
  return {.mean = film.mean(0), .error = film.standard_error(0)};
}

struct Mean {
  double value = 0.0;
  double error = 0.0;  ///< standard, of independent pixels
};
Mean mean_of(const Picture& picture) {
  Mean mean;
  const auto n = static_cast<double>(picture.mean.pixels().size());
  for (std::size_t i = 0; i < picture.mean.pixels().size(); ++i) {
    mean.value += picture.mean.pixels()[i] / n;
    mean.error += std::pow(picture.error.pixels()[i] / n, 2);
  }
  mean.error = std::sqrt(mean.error);
  return mean;
}

CameraModel camera(const Vector3d& eye, const Vector3d& target, double focal_px) {
  return testing::square_camera(eye, target, focal_px, kSize);
}

/// A room with a lamp under its ceiling, a mirror and a ball of glass.
Scene room() {
  Scene scene;
  scene.materials = {
      {.name = "wall", .kd = Vector3d(0.7, 0.6, 0.5)},
      {.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d(8.0, 6.0, 4.0)},
      {.name = "mirror", .bsdf = BsdfKind::mirror, .reflectance = Vector3d::Constant(0.9)},
      {.name = "glass", .bsdf = BsdfKind::dielectric}};
  Mesh box = make_box({-100, -150, 0}, {100, 150, 200}, 0);
  for (Eigen::Vector3i& triangle : box.triangles) {
    std::swap(triangle[1], triangle[2]);
  }
  scene.meshes = {box,
                  make_quad({-60, -60, 180}, {-60, 60, 180}, {60, 60, 180}, {60, -60, 180}, 1),
                  make_quad({90, -80, 20}, {90, -80, 120}, {90, 80, 120}, {90, 80, 20}, 2)};
  scene.spheres = {{.centre = {-30, 60, 40}, .radius_mm = 30.0, .material = 3}};
  return scene;
}

/// Means over the picture and its colours within 3.5 of their standard errors (one honest comparison in 2000
/// is not; the seeds are fixed), of independent samples, so that the errors are true.
TEST(NaivePaths, AgreeWithPathsThatAreUsedAtEachVertex) {
  const Scene scene = room();
  const CameraModel model = camera({-60, -140, 120}, {20, 60, 60}, 10.0);
  const RayCaster caster(scene);
  for (const int bounces : {3, 8}) {
    const Mean naive = mean_of(
        render(NaivePathIntegrator(scene, caster, nullptr, model,
                                   {.ray = {.sampler = SamplerKind::independent, .seed = 7},
                                    .most_bounces = bounces,
                                    .sure_bounces = 2}),
               256));
    PathOptions options;
    options.sampler = SamplerKind::independent;
    options.most_bounces = bounces;
    options.sampling = DirectSampling::light;
    const Mean path =
        mean_of(render(PathIntegrator(scene, caster, nullptr, model, options), 1024));
    const double sigma = std::hypot(naive.error, path.error);
    std::printf("%d bounces: naive %.5f, path %.5f, standard error %.5f\n", bounces,
                naive.value, path.value, sigma);
    EXPECT_LE(sigma, 0.005 * path.value) << "weak: it would see no error of 2 %";
    EXPECT_LE(std::abs(naive.value - path.value), 3.5 * sigma);
  }
}

/// Rays of a new path for each length grow with the square of the bounces: in a room where all is
/// reflected 0, 1, ... b bounces cost 1 + 2 + ... and a lamp asked each.
TEST(NaivePaths, CastRaysByTheSquareOfTheirBounces) {
  Scene scene = room();
  scene.materials[0].kd = Vector3d::Ones();
  scene.meshes.resize(1);
  scene.spheres.clear();
  scene.point_lights = {{.position = {0, 0, 150}, .intensity = Vector3d::Constant(1e4)}};
  const RayCaster caster(scene);
  constexpr int kBounces = 6;
  const NaivePathIntegrator naive(scene, caster, nullptr,
                                  camera({-60, -140, 120}, {20, 60, 60}, 10.0),
                                  {.most_bounces = kBounces});
  Film film(kSize, kSize, surface_layers(false));
  const RunResult result = run(naive, {.samples = 4}, film);
  constexpr double kSamples = 4.0 * kSize * kSize;
  constexpr double kEach = 0.5 * (kBounces + 1) * (kBounces + 2) + kBounces;
  // Lamps behind a wall's horizon are not asked; a ray in a thousand slips through an edge.
  EXPECT_NEAR(static_cast<double>(result.n_rays), kEach * kSamples, 0.01 * kEach * kSamples);
}

/// A plate above a floor is lit from below, and lights the floor, which is in its own shadow: L =
/// rho/pi E, where E is that of the plate as a lamp of radiance rho E cos/pi, in closed form. 16 seeds, |t| <= 4.07:
/// one false alarm in 1000 for 15 degrees of freedom.
TEST(AreaPaths, OfSeparatedSurfacesAreTheClosedForm) {
  constexpr double kFloor = 0.6;
  constexpr double kPlate = 0.8;
  Scene scene;
  scene.materials = {{.name = "floor", .kd = Vector3d::Constant(kFloor)},
                     {.name = "plate", .kd = Vector3d::Constant(kPlate)}};
  const std::array<Vector3d, 4> plate{Vector3d(-40, -30, 60), Vector3d(-40, 50, 60),
                                      Vector3d(60, 50, 60), Vector3d(60, -30, 60)};
  scene.meshes = {make_quad({-20, -20, 0}, {20, -20, 0}, {20, 20, 0}, {-20, 20, 0}, 0),
                  make_quad(plate[0], plate[1], plate[2], plate[3], 1)};
  // So slanted that the floor's shadow is beside the plate.
  const Vector3d direction = Vector3d(0.0, 4.0, 1.0).normalized();
  scene.directional_lights = {{.direction = direction, .irradiance = Vector3d::Constant(2.0)}};
  const double radiance = kPlate / pi * 2.0 * direction.z();
  const double truth = kFloor / pi * radiance *
                       polygon_irradiance(plate, Vector3d::Zero(), Vector3d::UnitZ()).value;
  const RayCaster caster(scene);
  constexpr int kSeeds = 16;
  std::vector<double> means;
  double mean = 0.0;
  for (int seed = 0; seed < kSeeds; ++seed) {
    const AreaPathIntegrator integrator(
        scene, caster, nullptr, camera({0, -60, 40}, {0, 0, 0}, 1e6),
        {.ray = {.seed = static_cast<std::uint64_t>(seed)}, .most_bounces = 2});
    means.push_back(mean_of(render(integrator, 64)).value);
    mean += means.back() / kSeeds;
  }
  double squares = 0.0;
  for (const double value : means) {
    squares += (value - mean) * (value - mean);
  }
  const double sigma = std::sqrt(squares / (kSeeds * (kSeeds - 1)));
  std::printf("%.6f, %.6f in closed form, standard error %.6f\n", mean, truth, sigma);
  EXPECT_LE(sigma, 0.002 * truth) << "weak";
  EXPECT_LE(std::abs(mean - truth), 4.07 * sigma + 1e-5 * truth);
}

/// Each part as often as its fraction of the area, chi^2 of 4 degrees of freedom below 18.5: one false alarm in 1000; each
/// point on its surface.
TEST(SurfacePoints, AreEvenOnAllSurfaces) {
  Scene scene;
  scene.materials = {{}};
  scene.meshes = {make_quad({0, 0, 0}, {20, 0, 0}, {20, 10, 0}, {0, 10, 0}, 0)};
  scene.spheres = {{.centre = {50, 0, 0}, .radius_mm = 4.0}};
  scene.disks = {{.centre = {0, 50, 0}, .normal = Vector3d::UnitY(), .radius_mm = 6.0}};
  scene.instances = {
      {.mesh = 0, .world_from_mesh = Eigen::Affine3d(Eigen::Translation3d(0, 0, 90))}};
  const SurfacePoints points(scene);
  const std::array<double, 5> areas{100.0, 100.0, 64.0 * pi, 36.0 * pi, 200.0};
  EXPECT_NEAR(points.area_mm2(), 400.0 + 100.0 * pi, 1e-9);
  std::array<double, 5> counts{};
  constexpr int kPoints = 20'000;
  const PixelSamples numbers(SamplerKind::independent, 3, 0, 0);
  for (std::uint32_t i = 0; i < kPoints; ++i) {
    const SurfacePoints::Point found = points.draw(numbers.two(i, 0));
    switch (found.surface) {
      case 0:  // two halves, left and right
        EXPECT_EQ(found.point.z(), 0.0);
        ++counts[found.point.x() < 10.0 ? 0 : 1];
        break;
      case 1:
        EXPECT_NEAR((found.point - Vector3d(50, 0, 0)).norm(), 4.0, 1e-12);
        ++counts[2];
        break;
      case 2:
        EXPECT_LE((found.point - Vector3d(0, 50, 0)).norm(), 6.0 + 1e-12);
        EXPECT_NEAR(found.point.y(), 50.0, 1e-12);
        ++counts[3];
        break;
      default:
        EXPECT_EQ(found.point.z(), 90.0);
        ++counts[4];
    }
  }
  double chi2 = 0.0;
  for (std::size_t i = 0; i < areas.size(); ++i) {
    const double wanted = kPoints * areas.at(i) / points.area_mm2();
    chi2 += (counts.at(i) - wanted) * (counts.at(i) - wanted) / wanted;
  }
  std::printf("chi^2 %.2f\n", chi2);
  EXPECT_LE(chi2, 18.5);
}

/// Lengths times 10^+-6, lamps times 10^+-20, no albedo and all, no area, no light: finite; the same bits
/// for any number of threads.
TEST(PathBaselines, AtTheEndsOfWhatCanBeWritten) {
  for (const double scale : {1e-6, 1.0, 1e6}) {
    for (const double factor : {0.0, 1e-20, 1e20}) {
      for (const double albedo : {0.0, 1.0}) {
        Scene scene = room();
        scene.materials[0].kd = Vector3d::Constant(albedo);
        scene.materials[1].emits *= factor;
        scene.meshes.push_back(make_quad({0, 0, 50}, {10, 0, 50}, {10, 0, 50}, {0, 0, 50}, 0));
        for (Mesh& mesh : scene.meshes) {
          for (Vector3d& vertex : mesh.vertices) {
            vertex *= scale;
          }
        }
        scene.spheres[0].centre *= scale;
        scene.spheres[0].radius_mm *= scale;
        const RayCaster caster(scene);
        const CameraModel model =
            camera(scale * Vector3d(-60, -140, 120), scale * Vector3d(20, 60, 60), 10.0);
        const PathBaselineOptions options{.most_bounces = 6};
        const NaivePathIntegrator naive(scene, caster, nullptr, model, options);
        const AreaPathIntegrator area(scene, caster, nullptr, model, options);
        for (const TileRenderer* integrator : {static_cast<const TileRenderer*>(&naive),
                                               static_cast<const TileRenderer*>(&area)}) {
          std::vector<std::vector<float>> pictures;
          for (const int threads : {1, 2, 7}) {
            const ThreadLimit limit(threads);
            const Image<float> picture = render(*integrator, 2).mean;
            pictures.emplace_back(picture.pixels().begin(), picture.pixels().end());
          }
          EXPECT_EQ(pictures[0], pictures[1]);
          EXPECT_EQ(pictures[0], pictures[2]);
          for (const float value : pictures[0]) {
            ASSERT_TRUE(std::isfinite(value) && value >= 0.0F) << value;
          }
        }
      }
    }
  }
}

}  // namespace
}  // namespace haarlight::render
