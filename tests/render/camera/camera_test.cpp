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

/// What a camera sees it shows where its rays go, and its importance is the area of the picture over
/// the rays' solid angle: by central differences, to 1e-7.
TEST(Camera, SeesWhatItsRaysMeet) {
  CameraModel distorted = model();
  distorted.distortion << 0.1, -0.02, 0.001, 0.002, 0.0;
  for (const CameraModel& of : {model(), distorted}) {
    for (const double radius : {0.0, 12.0}) {
      const Camera camera(of, {.lens_radius_mm = radius, .focus_mm = 350.0});
      const Vector2d lens(0.3, 0.8);
      for (const Vector2d& at :
           {Vector2d(31.0, 25.0), Vector2d(3.5, 40.0), Vector2d(60.0, -2.0)}) {
        const Ray ray = camera.ray(at.x(), at.y(), lens);
        const auto sight = camera.sees(ray.origin + 470.0 * ray.direction, lens);
        ASSERT_TRUE(sight.has_value());
        EXPECT_NEAR((sight->at - at).norm(), 0.0, 1e-9);
        EXPECT_NEAR(sight->distance_mm, 470.0, 1e-9);
        EXPECT_NEAR((sight->ray.direction - ray.direction).norm(), 0.0, 1e-12);
        constexpr double kStep = 1e-3;
        const auto along = [&](double x, double y) -> Vector3d {
          return camera.ray(at.x() + x, at.y() + y, lens).direction;
        };
        const Vector3d by_x = (along(kStep, 0.0) - along(-kStep, 0.0)) / (2.0 * kStep);
        const Vector3d by_y = (along(0.0, kStep) - along(0.0, -kStep)) / (2.0 * kStep);
        const double truth = 1.0 / by_x.cross(by_y).norm();
        EXPECT_NEAR(camera.pixels_per_sr(ray, at.x(), at.y()) / truth, 1.0, 1e-7);
        EXPECT_NEAR(sight->pixels_per_sr / truth, 1.0, 1e-7);
      }
    }
  }
}

TEST(Camera, DoesNotSeeWhatNoneOfItsRaysMeets) {
  const Vector2d lens(0.5, 0.5);
  const Camera pinhole(model(), {.near_mm = 100.0, .far_mm = 400.0});
  const Ray axis = pinhole.ray(31.0, 25.0, lens);
  EXPECT_FALSE(pinhole.sees(axis.origin - 200.0 * axis.direction, lens));
  EXPECT_FALSE(pinhole.sees(axis.origin + 99.0 * axis.direction, lens));
  EXPECT_TRUE(pinhole.sees(axis.origin + 101.0 * axis.direction, lens));
  EXPECT_FALSE(pinhole.sees(axis.origin + 401.0 * axis.direction, lens));
  const Camera orthographic(model(), {.pixel_mm = 2.0});
  EXPECT_FALSE(orthographic.can_be_reached());
  const Ray parallel = orthographic.ray(20.0, 20.0, lens);
  EXPECT_FALSE(orthographic.sees(parallel.origin + 200.0 * parallel.direction, lens));
  EXPECT_EQ(orthographic.pixels_per_sr(parallel, 20.0, 20.0), 0.0);
  // Barrel distortion folds back beyond r^2 = 1/(3 |k1|): from there a point of the picture is that
  // of another direction.
  CameraModel folded = model();
  folded.distortion << -0.3, 0.0, 0.0, 0.0, 0.0;
  const Camera fisheye(folded);
  const auto at_radius = [&](double r) -> Vector3d {
    return folded.world_from_cam * (200.0 * Vector3d(r, 0.0, 1.0));
  };
  EXPECT_TRUE(fisheye.sees(at_radius(1.0), lens));
  EXPECT_FALSE(fisheye.sees(at_radius(1.3), lens));
}

}  // namespace
}  // namespace haarlight::render
