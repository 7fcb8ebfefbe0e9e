// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/rectify.h"

#include <gtest/gtest.h>

#include "haarlight/core/rig/rig.h"

namespace haarlight::relight {
namespace {

PlaneFrame test_frame(double texel) {
  ShadowPlane plane;
  plane.extent_u_mm = 200.0;
  plane.extent_v_mm = 160.0;
  plane.texel_mm = texel;
  return make_plane_frame(plane);
}

CameraModel test_camera() {
  CameraModel camera;
  camera.width = 320;
  camera.height = 240;
  camera.fx = camera.fy = 440.0;
  camera.cx = 160.0;
  camera.cy = 120.0;
  camera.distortion << -0.08, 0.01, 0.001, -0.0005, 0.0;
  camera.world_from_cam =
      look_at({0.0, -560.0, 520.0}, {0.0, 0.0, 0.0}, Eigen::Vector3d::UnitZ());
  return camera;
}

/// A smooth pattern painted on the plane.
double pattern(const Eigen::Vector3d& p) {
  return 0.5 + 0.2 * std::sin(p.x() / 15.0) + 0.2 * std::cos(p.y() / 20.0);
}

Image<float> photograph(const CameraModel& camera) {
  Image<float> picture(camera.height, camera.width, 1);
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      const CameraRay ray = ray_through(camera, x + 0.5, y + 0.5);
      const double t = -ray.origin_world.z() / ray.direction_world.z();
      picture(y, x) = static_cast<float>(pattern(ray.origin_world + t * ray.direction_world));
    }
  }
  return picture;
}

TEST(PlaneFrame, PictureAndWorldAreInverse) {
  const PlaneFrame frame = test_frame(2.0);
  EXPECT_EQ(frame.width, 100);
  EXPECT_EQ(frame.height, 80);
  // conventions.md: pixel (i, j) is (x0 + (i + 0.5) s, y0 - (j + 0.5) s).
  EXPECT_TRUE(frame.world_of(0.5, 0.5).isApprox(Eigen::Vector3d(-99.0, 79.0, 0.0)));
  const Eigen::Vector2d back = frame.picture_of(frame.world_of(12.25, 3.75));
  EXPECT_NEAR(back.x(), 12.25, 1e-12);
  EXPECT_NEAR(back.y(), 3.75, 1e-12);
}

TEST(PlaneSampler, FindsThePatternThroughADistortedLens) {
  const CameraModel camera = test_camera();
  const PlaneFrame frame = test_frame(2.0);
  const PlaneSampler sampler(camera, frame);
  EXPECT_DOUBLE_EQ(sampler.known_fraction(), 1.0);
  const Image<float> plane = sampler.rectify(photograph(camera).view());
  double worst = 0.0;
  for (int y = 0; y < frame.height; ++y) {
    for (int x = 0; x < frame.width; ++x) {
      const double truth = pattern(frame.world_of(x + 0.5, y + 0.5));
      worst = std::max(worst, std::abs(truth - static_cast<double>(plane(y, x))));
    }
  }
  // Bilinear: h^2/8 times the second derivative 0.2/225, h the 2.9 mm of a slanted pixel,
  // twice.
  EXPECT_LT(worst, 2.5e-3);
}

TEST(PlaneSampler, MarksWhatTheCameraDoesNotSee) {
  CameraModel camera = test_camera();
  const PlaneFrame frame = test_frame(2.0);
  camera.cx = 40.0;  // the plane's left part falls out of the picture
  const PlaneSampler sampler(camera, frame);
  EXPECT_EQ(sampler.known()(40, 0), 0);
  EXPECT_EQ(sampler.known()(40, 99), 1);
}

TEST(PlaneSampler, MarksWhatTheObjectHides) {
  const CameraModel camera = test_camera();
  const PlaneFrame frame = test_frame(2.0);
  Image<std::uint8_t> mask(camera.height, camera.width, 1);
  for (std::uint8_t& m : mask.pixels()) {
    m = 1;
  }
  const auto centre = project(camera, Eigen::Vector3d::Zero());
  mask(static_cast<int>(centre->y()), static_cast<int>(centre->x())) = 0;
  const PlaneSampler sampler(camera, frame, mask.view());
  EXPECT_EQ(sampler.known()(40, 50), 0);
  EXPECT_EQ(sampler.known()(10, 10), 1);
  EXPECT_GT(sampler.known_fraction(), 0.99);
}

TEST(PlaneSampler, AveragesWhenTheCameraIsFiner) {
  CameraModel camera = test_camera();
  const PlaneSampler sampler(camera, test_frame(20.0));
  EXPECT_GT(sampler.n_samples(), 4);
  Image<float> ones(camera.height, camera.width, 1);
  for (float& v : ones.pixels()) {
    v = 1.0F;
  }
  const Image<float> plane = sampler.rectify(ones.view());
  for (const float v : plane.pixels()) {
    EXPECT_NEAR(v, 1.0F, 1e-5F);
  }
}

}  // namespace
}  // namespace haarlight::relight
