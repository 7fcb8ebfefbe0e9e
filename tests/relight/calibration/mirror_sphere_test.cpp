// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/calibration/mirror_sphere.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <numbers>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"

namespace haarlight::relight {
namespace {

CameraModel camera_above() {
  CameraModel camera;
  camera.width = camera.height = 2000;
  camera.fx = camera.fy = 3000.0;
  camera.cx = camera.cy = 1000.0;
  camera.distortion << -0.1, 0.02, 1e-3, -5e-4, 0.0;
  camera.world_from_cam = look_at({30.0, -20.0, 800.0}, {0, 0, 0}, {0, 1, 0});
  return camera;
}

TEST(MirrorSphere, FromItsOutlineIsWhereItIs) {
  const CameraModel camera = camera_above();
  const MirrorSphere truth{{90.0, -40.0, 12.0}, 12.0};
  // The circle where rays touch: at right angles to the way to the centre.
  const Eigen::Vector3d way = camera.centre_world() - truth.centre_mm;
  const double d = way.norm();
  const double cos_tangent = truth.radius_mm / d;
  const Eigen::Vector3d a = way.unitOrthogonal();
  const Eigen::Vector3d b = way.normalized().cross(a);
  std::vector<Eigen::Vector2d> outline;
  for (int i = 0; i < 40; ++i) {
    const double t = 2.0 * std::numbers::pi * i / 40.0;
    const double s = std::sqrt(1.0 - cos_tangent * cos_tangent);
    const Eigen::Vector3d n =
        cos_tangent * way.normalized() + s * (std::cos(t) * a + std::sin(t) * b);
    outline.push_back(project(camera, truth.centre_mm + truth.radius_mm * n).value());
  }
  const MirrorSphere found = sphere_from_outline(camera, outline, 12.0);
  EXPECT_LT((found.centre_mm - truth.centre_mm).norm(), 1e-6);
  EXPECT_THROW((void)sphere_from_outline(
                   camera, std::span<const Eigen::Vector2d>(outline).first(2), 12.0),
               Error);
}

TEST(MirrorSphere, RaysOfGlintsMeetAtTheLight) {
  const CameraModel camera = camera_above();
  const Eigen::Vector3d light(200.0, 150.0, 400.0);
  std::vector<ReflectedRay> rays;
  for (const Eigen::Vector3d& at :
       {Eigen::Vector3d(0, 0, 10), Eigen::Vector3d(90, 0, 10), Eigen::Vector3d(0, -80, 10)}) {
    const MirrorSphere sphere{at, 10.0};
    rays.push_back(reflect_off(camera, sphere, glint_of(camera, sphere, light)));
  }
  const Triangulated found = intersect(rays);
  EXPECT_LT((found.position_mm - light).norm(), 1e-5);
  EXPECT_LT(found.rms_mm, 1e-5);
  EXPECT_GT(found.conditioning, 1e-3);
  rays.resize(1);
  EXPECT_THROW((void)intersect(rays), Error);
  rays.push_back({rays[0].origin_mm + Eigen::Vector3d(50, 0, 0), rays[0].direction});
  EXPECT_THROW((void)intersect(rays), Error);
  EXPECT_THROW((void)reflect_off(camera, {{0, 0, 0}, 10.0}, {10.0, 10.0}), Error);
}

TEST(MirrorSphere, GlintOfALightJustAboveTheBallIsReflectedBackToIt) {
  const CameraModel camera = camera_above();
  const MirrorSphere sphere{{30.0, -20.0, 15.0}, 15.0};
  for (const double away : {15.1, 17.0, 20.0, 30.0, 1e7}) {
    const Eigen::Vector3d light =
        sphere.centre_mm + away * Eigen::Vector3d(0.2, 0.1, 1.0).normalized();
    const ReflectedRay ray = reflect_off(camera, sphere, glint_of(camera, sphere, light));
    const Eigen::Vector3d to_light = (light - ray.origin_mm).normalized();
    // A glint to 1e-9 pixels of 0.3 mm, on a ball of 15 mm and 0.1 mm from the light.
    EXPECT_LT((ray.direction - to_light).norm(), 1e-7) << away;
  }
}

TEST(MirrorSphere, HighlightIsFoundToAFractionOfAPixel) {
  Image<float> picture(60, 80, 1);
  Image<float> mask(60, 80, 1);
  for (int y = 0; y < 60; ++y) {
    for (int x = 0; x < 80; ++x) {
      const double out = std::hypot(x + 0.5 - 40.3, y + 0.5 - 29.6) - 22.4;
      mask(y, x) = static_cast<float>(std::clamp(0.5 - out, 0.0, 1.0));
      const double r2 = std::pow(x + 0.5 - 47.27, 2) + std::pow(y + 0.5 - 21.64, 2);
      picture(y, x) = static_cast<float>(0.05 + std::exp(-r2 / 8.0));
    }
  }
  picture(2, 2) = 9.0F;  // outside the ball
  const PictureCircle ball = fit_circle(outline_points(mask.view()));
  EXPECT_NEAR(ball.x, 40.3, 0.05);
  EXPECT_NEAR(ball.y, 29.6, 0.05);
  EXPECT_NEAR(ball.radius, 22.4, 0.05);
  const Eigen::Vector2d at = find_highlight(picture.view(), ball);
  EXPECT_NEAR(at.x(), 47.27, 0.15);
  EXPECT_NEAR(at.y(), 21.64, 0.15);
  EXPECT_THROW((void)find_highlight(mask.view(), ball), Error);  // white all over
  EXPECT_THROW((void)find_highlight(Image<float>(60, 80, 1).view(), ball), Error);
  picture(21, 50) = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THROW((void)find_highlight(picture.view(), ball), Error);
  EXPECT_THROW((void)outline_points(Image<float>(60, 80, 1).view()), Error);
  EXPECT_THROW((void)mirror_direction(ball, {70.0, 29.0}), Error);
  EXPECT_TRUE(mirror_direction(ball, {ball.x, ball.y}).isApprox(Eigen::Vector3d::UnitZ()));
  // Half way up the ball's edge: the light comes from the side.
  const Eigen::Vector3d side =
      mirror_direction(ball, {ball.x + ball.radius * std::sqrt(0.5), ball.y});
  EXPECT_NEAR(side.x(), 1.0, 1e-9);
}

TEST(MirrorSphere, ChromeBallsLightsAreThoseOfItsList) {
  const std::filesystem::path folder = "../shared/data/balls";
  if (!std::filesystem::exists(folder / "lights.txt")) {
    GTEST_SKIP() << folder << " is absent";
  }
  std::ifstream list(folder / "lights.txt");
  int n = 0;
  list >> n;
  ASSERT_EQ(n, 12);
  const PictureFile mask = read_picture(folder / "chrome" / "chrome.mask.tga");
  const PictureCircle ball = fit_circle(outline_points(mask.pixels.view()));
  double sum = 0.0;
  for (int i = 0; i < n; ++i) {
    Eigen::Vector3d truth;
    list >> truth.x() >> truth.y() >> truth.z();
    const PictureFile picture =
        read_picture(folder / "chrome" / ("chrome." + std::to_string(i) + ".tga"));
    const Eigen::Vector3d found =
        mirror_direction(ball, find_highlight(picture.pixels.view(), ball));
    const double angle = std::acos(std::min(1.0, found.dot(truth.normalized())));
    sum += angle * 180.0 / std::numbers::pi;
  }
  RecordProperty("mean_degrees", std::to_string(sum / n));
  EXPECT_LE(sum / n, 3.1);
}

}  // namespace
}  // namespace haarlight::relight
