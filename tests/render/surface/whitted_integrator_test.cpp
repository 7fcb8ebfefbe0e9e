// SPDX-License-Identifier: Apache-2.0
/// @file
/// Ray casting and Whitted's ray tracing: where they are the same as path tracing, and what they leave
/// out.

#include "render/surface/whitted_integrator.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <numbers>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"
#include "tests/render/surface/square_camera.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

constexpr int kSize = 24;

CameraModel camera(const Vector3d& eye, const Vector3d& target, double fov_deg) {
  const double focal_px = 0.5 * kSize / std::tan(0.5 * fov_deg * std::numbers::pi / 180.0);
  return testing::square_camera(eye, target, focal_px, kSize);
}

struct Picture {
  Image<float> mean;
  Image<float> error;
};

Picture render(const TileRenderer& integrator, std::uint32_t samples) {
  Film film(kSize, kSize, surface_layers(false));
  EXPECT_EQ(run(integrator, {.samples = samples}, film).samples, samples);
  return {film.mean(0), film.standard_error(0)};
}

Picture whitted(const Scene& scene, const CameraModel& model, int most_bounces,
                std::uint32_t samples) {
  const RayCaster caster(scene);
  return render(WhittedIntegrator(scene, caster, nullptr, model,
                                  {.ray = {}, .most_bounces = most_bounces}),
                samples);
}

Picture path(const Scene& scene, const CameraModel& model, int most_bounces,
             std::uint32_t samples) {
  PathOptions options;
  options.most_bounces = most_bounces;
  options.sure_bounces = most_bounces;
  const RayCaster caster(scene);
  return render(PathIntegrator(scene, caster, nullptr, model, options), samples);
}

/// The largest difference, over the largest value.
double difference(const Picture& a, const Picture& b) {
  double largest = 0.0;
  double off = 0.0;
  for (std::size_t i = 0; i < a.mean.pixels().size(); ++i) {
    const double first = a.mean.pixels()[i];
    largest = std::max(largest, std::abs(first));
    off = std::max(off, std::abs(first - double{b.mean.pixels()[i]}));
  }
  EXPECT_GT(largest, 0.0);
  return off / largest;
}

int add(Scene& scene, Material material) {
  scene.materials.push_back(std::move(material));
  return static_cast<int>(scene.materials.size()) - 1;
}

/// A floor and a wall, which see each other, under lamps without extent.
Scene under_point_lights() {
  Scene scene;
  const int stone = add(scene, {.name = "stone", .kd = Vector3d(0.7, 0.5, 0.3)});
  const int plaster = add(scene, {.name = "plaster",
                                  .kd = Vector3d::Constant(0.6),
                                  .bsdf = BsdfKind::oren_nayar,
                                  .sigma = 0.5});
  const int lacquer = add(scene, {.name = "lacquer",
                                  .kd = Vector3d::Constant(0.4),
                                  .bsdf = BsdfKind::coated,
                                  .roughness = 0.3});
  scene.meshes.push_back(
      make_quad({-300, -300, 0}, {300, -300, 0}, {300, 300, 0}, {-300, 300, 0}, stone));
  scene.meshes.push_back(
      make_quad({-300, 300, 0}, {300, 300, 0}, {300, 300, 300}, {-300, 300, 300}, plaster));
  scene.meshes.push_back(make_sphere({40, 60, 50}, 50.0, 3, lacquer));
  scene.point_lights.push_back(
      {.position = {100, -50, 250}, .intensity = Vector3d(3e4, 2e4, 1e4)});
  scene.point_lights.push_back(
      {.position = {-150, 20, 180}, .intensity = Vector3d(1e4, 2e4, 3e4)});
  scene.directional_lights.push_back(
      {.direction = Vector3d(0.1, 0.3, -1.0).normalized(), .irradiance = Vector3d::Ones()});
  return scene;
}

/// Without extent of lights nothing is drawn but the point in the pixel, which is the same: equal but
/// for the rounding of floats. Path tracing asks all lights here, too.
TEST(RayCasting, IsDirectLightWhereNothingIsDrawn) {
  const Scene scene = under_point_lights();
  const CameraModel model = camera({50, -400, 250}, {0, 50, 50}, 60.0);
  PathOptions options;
  options.most_bounces = 1;
  options.lights = LightChoice::all;
  const RayCaster caster(scene);
  const Picture direct = render(PathIntegrator(scene, caster, nullptr, model, options), 4);
  const double off = difference(whitted(scene, model, 0, 4), direct);
  std::printf("largest difference %.2g\n", off);
  EXPECT_LE(off, 1e-6);
}

/// A mirror shows the floor. Paths of two bounces have no others, as the floor is flat.
TEST(Whitted, IsPathTracingOverAMirror) {
  Scene scene;
  const int stone = add(scene, {.name = "stone", .kd = Vector3d(0.7, 0.5, 0.3)});
  const int mirror =
      add(scene,
          {.name = "mirror", .bsdf = BsdfKind::mirror, .reflectance = Vector3d(0.9, 0.8, 0.7)});
  scene.meshes.push_back(
      make_quad({-300, -300, 0}, {300, -300, 0}, {300, 300, 0}, {-300, 300, 0}, stone));
  scene.meshes.push_back(
      make_quad({-300, 200, 1}, {300, 200, 1}, {300, 200, 301}, {-300, 200, 301}, mirror));
  scene.point_lights.push_back(
      {.position = {100, -50, 250}, .intensity = Vector3d(3e4, 2e4, 1e4)});
  const CameraModel model = camera({50, -250, 150}, {0, 200, 100}, 50.0);
  const Picture picture = whitted(scene, model, 64, 4);
  EXPECT_LE(difference(picture, path(scene, model, 2, 4)), 1e-6);
  // Ray casting ends at the mirror: it is black there.
  EXPECT_GT(difference(picture, whitted(scene, model, 0, 4)), 0.1);
}

/// What loses no light shows, within walls that emit all alike, what they emit.
TEST(Whitted, AFurnaceShowsNothingOfGlass) {
  constexpr double kEmitted = 2.0;
  for (const double ior : {1.0, 1.5, 4.0}) {
    Scene scene;
    const int wall = add(
        scene, {.name = "wall", .kd = Vector3d::Zero(), .emits = Vector3d::Constant(kEmitted)});
    const int glass = add(scene, {.name = "glass", .bsdf = BsdfKind::dielectric, .ior = ior});
    Mesh box = make_box({-300, -300, -300}, {300, 300, 300}, wall);
    for (Eigen::Vector3i& triangle : box.triangles) {
      std::swap(triangle[1], triangle[2]);
    }
    scene.meshes.push_back(box);
    scene.meshes.push_back(make_box({-80, -60, -70}, {80, 60, 70}, glass));
    const Picture picture = whitted(scene, camera({20, -250, 60}, {0, 0, 0}, 40.0), 1000, 16);
    for (int y = 0; y < kSize; ++y) {
      for (int x = 0; x < kSize; ++x) {
        EXPECT_NEAR(picture.mean(y, x), kEmitted, 1e-6) << ior;
      }
    }
  }
}

/// A lamp as large as a room: points of it, beside points and directions weighted. Means over the
/// picture, 3.5 of their standard errors apart at most: one in 2000 honest comparisons; the seeds are fixed.
TEST(RayCasting, AgreesWithDirectLightOfALargeLamp) {
  Scene scene = under_point_lights();
  scene.point_lights.clear();
  scene.directional_lights.clear();
  const int lamp =
      add(scene, {.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d(4.0, 2.0, 1.0)});
  scene.meshes.push_back(
      make_quad({-250, -250, 280}, {-250, 250, 280}, {250, 250, 280}, {250, -250, 280}, lamp));
  const CameraModel model = camera({50, -400, 200}, {0, 50, 30}, 50.0);
  double means[2] = {};
  double errors[2] = {};
  const Picture pictures[2] = {whitted(scene, model, 0, 256), path(scene, model, 1, 256)};
  for (int i = 0; i < 2; ++i) {
    for (int y = 0; y < kSize; ++y) {
      for (int x = 0; x < kSize; ++x) {
        means[i] += pictures[i].mean(y, x) / (kSize * kSize);
        errors[i] += std::pow(pictures[i].error(y, x) / (kSize * kSize), 2);
      }
    }
  }
  const double sigma = std::sqrt(errors[0] + errors[1]);
  std::printf("%.5f and %.5f, a standard error of %.5f\n", means[0], means[1], sigma);
  EXPECT_LE(sigma, 0.003 * means[1]) << "weak: it would see no error of 1 %";
  EXPECT_LE(std::abs(means[0] - means[1]), 3.5 * sigma);
}

}  // namespace
}  // namespace haarlight::render
