// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/direct/picture.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/render/analytic/polygon_light.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

CameraModel small_camera() {
  CameraModel camera;
  camera.width = 24;
  camera.height = 18;
  camera.fx = camera.fy = 33.0;
  camera.cx = 12.0;
  camera.cy = 9.0;
  camera.world_from_cam = look_at({0, -560, 520}, {0, 5, 45}, Vector3d::UnitZ());
  return camera;
}

std::vector<SquareLight> face() {
  std::vector<SquareLight> lights;
  for (int row = 0; row < 4; ++row) {
    for (int col = 0; col < 4; ++col) {
      SquareLight light;
      light.centre = {(col - 1.5) * 240.0, (row - 1.5) * 240.0, 900.0};
      light.width_mm = light.height_mm = 200.0;
      lights.push_back(light);
    }
  }
  return lights;
}

Scene scene_with_ball() {
  Scene scene;
  scene.materials.push_back({"ground", Vector3d(0.8, 0.6, 0.4), 0.0, 1.0});
  scene.materials.push_back({"ball", Vector3d(0.1, 0.2, 0.3), 0.4, 50.0});
  scene.meshes.push_back(
      make_quad({-1000, -1000, 0}, {1000, -1000, 0}, {1000, 1000, 0}, {-1000, 1000, 0}, 0));
  scene.meshes.push_back(make_sphere({0, 0, 50}, 50.0, 4, 1));
  return scene;
}

TEST(RenderLit, OfAPlaneIsTheClosedForm) {
  Scene scene = scene_with_ball();
  scene.meshes.pop_back();
  const std::vector<SquareLight> lights = face();
  std::vector<Vector3d> weights;
  for (int k = 0; k < 16; ++k) {
    weights.emplace_back(0.1 * k, 1.0, 2.0 - 0.1 * k);
  }
  const CameraModel camera = small_camera();
  const LitPicture picture = render_lit(scene, camera, lights, weights, {.n_subpixels = 1});
  for (int y = 0; y < 18; y += 3) {
    for (int x = 0; x < 24; x += 3) {
      const CameraRay ray = ray_through(camera, x + 0.5, y + 0.5);
      const Vector3d p = ray.origin_world -
                         ray.origin_world.z() / ray.direction_world.z() * ray.direction_world;
      Vector3d expected = Vector3d::Zero();
      for (std::size_t k = 0; k < lights.size(); ++k) {
        expected += light_irradiance(lights[k], p, Vector3d::UnitZ()) / std::numbers::pi *
                    weights[k].cwiseProduct(scene.materials[0].kd);
      }
      for (int c = 0; c < 3; ++c) {
        // 141 mm of radius at 760 mm: 4 x 4 Gauss points, below 1e-6; float 1e-7.
        EXPECT_NEAR(picture.radiance(y, x, c), expected[c], 2e-6 * expected[c]);
        EXPECT_EQ(picture.error(y, x, c), 0.0F);
      }
      EXPECT_EQ(picture.coverage(y, x), 1.0F);
    }
  }
  EXPECT_EQ(picture.relative_error, 0.0);
}

TEST(RenderLit, IsLinearInTheWeights) {
  const Scene scene = scene_with_ball();
  const std::vector<SquareLight> lights = face();
  std::vector<Vector3d> a(16, Vector3d::Ones());
  std::vector<Vector3d> b(16, Vector3d(0.5, 2.0, 1.0));
  std::vector<Vector3d> both;
  for (int k = 0; k < 16; ++k) {
    both.emplace_back(a[static_cast<std::size_t>(k)] + 3.0 * b[static_cast<std::size_t>(k)]);
  }
  const CameraModel camera = small_camera();
  const LitPicture of_a = render_lit(scene, camera, lights, a);
  const LitPicture of_b = render_lit(scene, camera, lights, b);
  const LitPicture of_both = render_lit(scene, camera, lights, both);
  for (std::size_t i = 0; i < of_a.radiance.pixels().size(); ++i) {
    const double sum = of_a.radiance.pixels()[i] + 3.0 * of_b.radiance.pixels()[i];
    EXPECT_NEAR(of_both.radiance.pixels()[i], sum, 1e-6 * sum + 1e-12);  // float sums
  }
}

TEST(RenderLit, IsTheSameOnOneTwoAndSevenThreads) {
  const Scene scene = scene_with_ball();
  const std::vector<SquareLight> lights = face();
  const std::vector<Vector3d> weights(16, Vector3d::Ones());
  std::vector<LitPicture> pictures;
  for (const int n : {1, 2, 7}) {
    const ThreadLimit limit(n);
    pictures.push_back(render_lit(scene, small_camera(), lights, weights));
  }
  for (int i = 1; i < 3; ++i) {
    const LitPicture& other = pictures[static_cast<std::size_t>(i)];
    EXPECT_TRUE(std::equal(other.radiance.pixels().begin(), other.radiance.pixels().end(),
                           pictures[0].radiance.pixels().begin()));
    EXPECT_EQ(other.n_rays, pictures[0].n_rays);
  }
}

TEST(RenderLit, ItsErrorEstimateCoversTheTruth) {
  const Scene scene = scene_with_ball();
  const std::vector<SquareLight> lights = face();
  const std::vector<Vector3d> weights(16, Vector3d::Ones());
  LitOptions coarse;
  coarse.direct.mixed_grid = 8;
  LitOptions fine;
  fine.direct.mixed_grid = 64;
  fine.direct.sample_all = true;
  const LitPicture rough = render_lit(scene, small_camera(), lights, weights, coarse);
  const LitPicture truth = render_lit(scene, small_camera(), lights, weights, fine);
  const Achieved achieved = compare(rough.radiance.pixels(), truth.radiance.pixels());
  EXPECT_GT(rough.relative_error, 1e-5);
  // The estimate is one standard error of the whole picture.
  EXPECT_LT(achieved.relative_l2, 2.0 * rough.relative_error);
  EXPECT_GT(achieved.relative_l2, 0.4 * rough.relative_error);
  EXPECT_LT(truth.relative_error, 0.2 * rough.relative_error);
}

TEST(RenderLit, BlackWeightsAndEmptyViewsGiveBackground) {
  const Scene scene = scene_with_ball();
  const std::vector<SquareLight> lights = face();
  const LitPicture black =
      render_lit(scene, small_camera(), lights, std::vector<Vector3d>(16, Vector3d::Zero()));
  for (const float value : black.radiance.pixels()) {
    EXPECT_EQ(value, 0.0F);
  }
  CameraModel away = small_camera();
  away.world_from_cam = look_at({0, 0, 500}, {0, 0, 1000}, Vector3d::UnitY());
  LitOptions options;
  options.background = {0.25, 0.5, 1.0};
  const LitPicture empty =
      render_lit(scene, away, lights, std::vector<Vector3d>(16, Vector3d::Ones()), options);
  EXPECT_EQ(empty.radiance(3, 3, 0), 0.25F);
  EXPECT_EQ(empty.radiance(3, 3, 2), 1.0F);
  EXPECT_EQ(empty.coverage(3, 3), 0.0F);
}

}  // namespace
}  // namespace haarlight::render
