// SPDX-License-Identifier: Apache-2.0
/// @file
/// What a camera with near_mm and far_mm sees, in closed form.

#include <cmath>
#include <limits>
#include <memory>
#include <numbers>

#include <gtest/gtest.h>

#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kSize = 40;

/// Looks along +y from the origin; the picture's up is +z.
CameraModel view() {
  CameraModel model;
  model.width = kSize;
  model.height = kSize;
  model.fx = model.fy = 30.0;
  model.cx = model.cy = 0.5 * kSize;
  model.world_from_cam = look_at(Vector3d::Zero(), Vector3d::UnitY(), Vector3d::UnitZ());
  return model;
}

TEST(Camera, ItsRaysBeginAndEndOnPlanesAcrossTheAxis) {
  for (const CameraOptics& optics :
       {CameraOptics{.near_mm = 80.0, .far_mm = 200.0},
        CameraOptics{.pixel_mm = 2.5, .near_mm = 80.0, .far_mm = 200.0},
        CameraOptics{
            .lens_radius_mm = 12.0, .focus_mm = 350.0, .near_mm = 80.0, .far_mm = 200.0}}) {
    const Camera camera(view(), optics);
    for (const double x : {0.0, 17.0, 40.0}) {
      const Ray ray = camera.ray(x, 5.5, Vector2d(0.8, 0.3));
      // Two roundings of numbers of 200.
      EXPECT_NEAR((ray.origin + ray.t_min * ray.direction).y(), 80.0, 1e-12);
      EXPECT_NEAR((ray.origin + ray.t_max * ray.direction).y(), 200.0, 1e-12);
    }
  }
  const Ray plain = Camera(view()).ray(3.0, 4.0, Vector2d::Zero());
  EXPECT_EQ(plain.t_min, 0.0);
  EXPECT_EQ(plain.t_max, std::numeric_limits<double>::infinity());
}

std::unique_ptr<Film> picture_of(const Scene& scene, const CameraOptics& optics) {
  const RayCaster caster(scene);
  const PathIntegrator integrator(scene, caster, nullptr, {view(), optics},
                                  {.most_bounces = 1, .has_features = true});
  auto film = std::make_unique<Film>(kSize, kSize, surface_layers(true));
  EXPECT_EQ(run(integrator, {.samples = 16}, *film).samples, 16U);
  return film;
}

constexpr double kBelow = 30.0;  // of the camera's axis: the ground

Mesh ground() {
  return make_quad({-900, -900, -kBelow}, {900, -900, -kBelow}, {900, 900, -kBelow},
                   {-900, 900, -kBelow}, 0);
}

/// How far along the axis the picture's point `row` pixels from the top sees the ground.
double depth_at(double row) { return 30.0 * kBelow / (row - 0.5 * kSize); }

TEST(ClippedView, IsWhatLiesBetweenNearAndFarWithTheShadowOfWhatDoesNot) {
  // A board 20 mm above the ground at 10 to 45 mm: it hides the ground up to 135 mm from a camera
  // that sees all. The light comes from behind at 45 degrees: its shadow reaches from 30 to 65 mm.
  Scene scene;
  scene.materials = {{.name = "white", .kd = Vector3d::Constant(0.8)}};
  scene.meshes = {
      ground(), make_quad({-900, 10, -10}, {900, 10, -10}, {900, 45, -10}, {-900, 45, -10}, 0)};
  scene.directional_lights = {
      {.direction = Vector3d(0.0, 1.0, -1.0).normalized(), .irradiance = Vector3d::Ones()}};
  const std::unique_ptr<Film> film = picture_of(scene, {.near_mm = 50.0, .far_mm = 150.0});
  const Image<float> radiance = film->mean(SurfaceLayer::kRadiance);
  const Image<float> depth = film->mean(SurfaceLayer::kDepth);
  const Image<float> coverage = film->mean(SurfaceLayer::kCoverage);
  int n_lit = 0;
  int n_in_shadow = 0;
  for (int y = kSize / 2 + 1; y < kSize; ++y) {
    // The samples of a row are between its edges.
    const double farthest = depth_at(y);
    const double nearest = depth_at(y + 1.0);
    for (int x = 0; x < kSize; ++x) {
      if (farthest <= 50.0 || nearest >= 150.0) {
        EXPECT_EQ(coverage(y, x), 0.0F) << x << ' ' << y;
        EXPECT_EQ(radiance(y, x), 0.0F);
        EXPECT_EQ(depth(y, x), 0.0F);
      }
      if (nearest <= 50.0 || farthest >= 150.0) {
        continue;  // outside, or partly so
      }
      EXPECT_EQ(coverage(y, x), 1.0F) << x << ' ' << y;
      EXPECT_GT(depth(y, x), nearest);
      EXPECT_LT(depth(y, x), farthest);
      if (farthest < 65.0) {
        EXPECT_EQ(radiance(y, x), 0.0F) << x << ' ' << y;
        ++n_in_shadow;
      } else if (nearest > 65.0) {
        EXPECT_FLOAT_EQ(radiance(y, x), 0.8F * std::sqrt(0.5F) / std::numbers::pi_v<float>);
        ++n_lit;
      }
    }
  }
  EXPECT_EQ(n_in_shadow, 3 * kSize) << "rows 34 to 36";
  EXPECT_EQ(n_lit, 6 * kSize) << "rows 27 to 32";
  // Without the planes the board is what these rows show.
  EXPECT_LT(picture_of(scene, {})->mean(SurfaceLayer::kDepth)(35, 20), 45.0F);
}

TEST(ClippedView, ShowsInAMirrorWhatTheCameraItselfDoesNotSee) {
  Scene scene;
  scene.materials = {
      {.name = "mirror", .bsdf = BsdfKind::mirror},
      {.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d::Constant(2.0)}};
  scene.meshes = {ground(), make_quad({-900, 400, -kBelow}, {900, 400, -kBelow},
                                      {900, 400, 900}, {-900, 400, 900}, 1)};
  const Image<float> open = picture_of(scene, {})->mean(SurfaceLayer::kRadiance);
  const Image<float> cut = picture_of(scene, {.far_mm = 150.0})->mean(SurfaceLayer::kRadiance);
  EXPECT_FLOAT_EQ(open(5, 20), 2.0F);
  EXPECT_EQ(cut(5, 20), 0.0F) << "the lamp is farther";
  EXPECT_FLOAT_EQ(open(35, 20), 2.0F);
  EXPECT_FLOAT_EQ(cut(35, 20), 2.0F) << "in the mirror";
}

}  // namespace
}  // namespace haarlight::render
