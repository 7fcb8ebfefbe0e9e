// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/rig/camera_model.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

namespace haarlight {
namespace {

CameraModel typical_camera() {
  CameraModel camera;
  camera.width = 640;
  camera.height = 480;
  camera.fx = 800.0;
  camera.fy = 810.0;
  camera.cx = 320.5;
  camera.cy = 239.0;
  camera.distortion << -0.28, 0.09, 1e-3, -5e-4, -0.01;
  camera.world_from_cam = look_at({100.0, -500.0, 400.0}, {0.0, 0.0, 30.0}, {0.0, 0.0, 1.0});
  return camera;
}

TEST(LookAt, PutsTheTargetInTheMiddleAndUpUpwards) {
  CameraModel camera;
  camera.cx = 50.0;
  camera.cy = 40.0;
  camera.fx = camera.fy = 100.0;
  camera.world_from_cam = look_at({0.0, -100.0, 0.0}, {0.0, 0.0, 0.0}, {0.0, 0.0, 1.0});
  const auto middle = project(camera, {0.0, 0.0, 0.0});
  ASSERT_TRUE(middle.has_value());
  EXPECT_NEAR(middle->x(), 50.0, 1e-12);
  EXPECT_NEAR(middle->y(), 40.0, 1e-12);
  EXPECT_LT(project(camera, {0.0, 0.0, 1.0})->y(), 40.0);  // world up is up in the picture
  EXPECT_GT(project(camera, {1.0, 0.0, 0.0})->x(), 50.0);  // +x is to the right from -y
  EXPECT_NEAR(camera.world_from_cam.linear().determinant(), 1.0, 1e-12);
}

TEST(Project, RefusesPointsBehindTheCamera) {
  const CameraModel camera = typical_camera();
  const Eigen::Vector3d behind = camera.world_from_cam * Eigen::Vector3d(0.0, 0.0, -1.0);
  EXPECT_FALSE(project(camera, behind).has_value());
}

TEST(Project, MatchesTheDistortionFormulaWorkedByHand) {
  CameraModel camera;
  camera.distortion << 0.1, 0.01, 0.001, 0.002, 0.0001;
  camera.fx = camera.fy = 1.0;
  // x = 0.5, y = 0.25: r2 = 0.3125; radial = 1 + .03125 + .0009765625 + .0000030517578125
  const double radial = 1.0322296142578125;
  const auto p = project(camera, {0.5, 0.25, 1.0});
  EXPECT_NEAR(p->x(), 0.5 * radial + 2 * 0.001 * 0.125 + 0.002 * (0.3125 + 0.5), 1e-15);
  EXPECT_NEAR(p->y(), 0.25 * radial + 0.001 * (0.3125 + 0.125) + 2 * 0.002 * 0.125, 1e-15);
}

RC_GTEST_PROP(RayThrough, IsTheInverseOfProject, ()) {
  const CameraModel camera = typical_camera();
  const double x = *rc::gen::inRange(0, 640'000) / 1000.0;
  const double y = *rc::gen::inRange(0, 480'000) / 1000.0;
  const double depth = *rc::gen::inRange(10, 10'000);
  const CameraRay ray = ray_through(camera, x, y);
  RC_ASSERT(std::abs(ray.direction_world.norm() - 1.0) < 1e-14);
  const auto p = project(camera, ray.origin_world + depth * ray.direction_world);
  RC_ASSERT(p.has_value());
  // Newton stops at 1e-14 of the focal length (800 px); the world coordinates of 1e4 mm carry
  // 1e-12 mm each, times 800/10 px a mm at the nearest depth.
  RC_ASSERT(std::abs(p->x() - x) < 1e-9);
  RC_ASSERT(std::abs(p->y() - y) < 1e-9);
}

}  // namespace
}  // namespace haarlight
