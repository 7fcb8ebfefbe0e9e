// SPDX-License-Identifier: Apache-2.0
#include "render/camera/camera.h"

#include <cmath>
#include <numbers>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

CameraModel model() {
  CameraModel model;
  model.width = 64;
  model.height = 48;
  model.fx = 70.0;
  model.fy = 80.0;
  model.cx = 31.0;
  model.cy = 25.0;
  model.world_from_cam =
      look_at(Vector3d(100, -300, 400), Vector3d(10, 20, 0), Vector3d::UnitZ());
  return model;
}

TEST(Camera, APinholesRaysAreTheModelsToTheBit) {
  CameraModel distorted = model();
  distorted.distortion << 0.1, -0.02, 0.001, 0.002, 0.0;
  const Camera camera(distorted);
  for (const double x : {0.0, 17.3, 64.0}) {
    const CameraRay truth = ray_through(distorted, x, 5.5);
    const Ray ray = camera.ray(x, 5.5, Vector2d(0.3, 0.9));
    EXPECT_EQ(ray.origin, truth.origin_world);
    EXPECT_EQ(ray.direction, truth.direction_world);
  }
  EXPECT_FALSE(camera.has_lens());
}

TEST(Camera, RaysThroughALensMeetInFocusAndStartOnTheAperture) {
  const CameraModel pinhole = model();
  const Camera camera(pinhole, {.lens_radius_mm = 12.0, .focus_mm = 350.0});
  ASSERT_TRUE(camera.has_lens());
  const CameraRay chief = ray_through(pinhole, 50.0, 7.0);
  const Vector3d focus = chief.origin_world + 350.0 / chief.direction_world.dot(camera.axis()) *
                                                  chief.direction_world;
  double farthest = 0.0;
  for (int j = 0; j < 20; ++j) {
    for (int i = 0; i < 20; ++i) {
      const Ray ray = camera.ray(50.0, 7.0, Vector2d((i + 0.5) / 20.0, (j + 0.5) / 20.0));
      EXPECT_NEAR(ray.direction.norm(), 1.0, 1e-15);
      const Vector3d away = ray.origin - chief.origin_world;
      EXPECT_NEAR(away.dot(camera.axis()), 0.0, 1e-12);
      farthest = std::max(farthest, away.norm());
      EXPECT_NEAR((focus - ray.origin).cross(ray.direction).norm(), 0.0, 1e-10);
      EXPECT_GT(ray.direction.dot(camera.axis()), 0.0);
    }
  }
  EXPECT_LE(farthest, 12.0);
  EXPECT_GT(farthest, 11.0);
}

TEST(Camera, AnOrthographicCamerasRaysAreParallel) {
  const CameraModel pinhole = model();
  const Camera camera(pinhole, {.pixel_mm = 2.5});
  const Ray a = camera.ray(31.0, 25.0, Vector2d::Zero());
  EXPECT_NEAR((a.origin - pinhole.centre_world()).norm(), 0.0, 1e-12);
  const Ray b = camera.ray(41.0, 21.0, Vector2d::Zero());
  EXPECT_EQ(a.direction, b.direction);
  const Vector3d between = pinhole.world_from_cam.linear().transpose() * (b.origin - a.origin);
  EXPECT_NEAR((between - Vector3d(25.0, -10.0, 0.0)).norm(), 0.0, 1e-12);
}

}  // namespace
}  // namespace haarlight::render
