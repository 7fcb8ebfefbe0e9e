// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/near_alternation.h"

#include <cmath>
#include <cstdio>

#include <gtest/gtest.h>

#include "tests/relight/shape/made_lights.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using testing::degrees_between;
using testing::MadeSurface;
using testing::near_capture;
using testing::vector_at;

StereoLights near_lights() {
  StereoLights lights;
  lights.are_near = true;
  lights.near = testing::light_array(6, 150.0, 600.0, 1.0);
  for (const NearLight& light : lights.near) {
    lights.directions.push_back(light.position_mm.normalized());
  }
  return lights;
}

TEST(NearAlternation, FlatPaperIsFlatUnderNearLightsAndACrispUnderTheFarModel) {
  constexpr double kWidth = 400.0;
  const PixelPoints pixels = PixelPoints::orthographic(40, 40, kWidth);
  StereoLights lights = near_lights();
  const MadeSurface paper{[&](int y, int x) { return pixels.at(x + 0.5, y + 0.5); },
                          [](int, int) { return Vector3d(Vector3d::UnitZ()); }};
  const MemoryStack stack = near_capture(40, 40, lights.near, paper);
  const Shape near = recover_shape(stack, lights, pixels, {});
  lights.are_near = false;
  const Shape far = recover_shape(stack, lights, pixels, {});
  std::printf("flat paper: far model bows by %.2f %% of the width, near model by %.1e %%\n",
              100.0 * far.bow_mm / kWidth, 100.0 * near.bow_mm / kWidth);
  EXPECT_GT(far.bow_mm / kWidth, 0.05);
  EXPECT_LT(near.bow_mm / kWidth, 1e-6);
  EXPECT_TRUE(near.is_settled);
  EXPECT_EQ(near.changes.size(), 1U);
}

/// A cap of a sphere of 300 mm, 200 mm across: 17 mm high.
TEST(NearAlternation, ACapStandsStillAtItsTrueNormals) {
  constexpr double kRadius = 300.0;
  constexpr int kSize = 60;
  const PixelPoints pixels = PixelPoints::orthographic(kSize, kSize, 200.0);
  const auto height = [](const Vector3d& p) {
    return std::sqrt(kRadius * kRadius - p.x() * p.x() - p.y() * p.y());
  };
  double mean = 0.0;
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      mean += height(pixels.at(x + 0.5, y + 0.5)) / (kSize * kSize);
    }
  }
  const auto point = [&](int y, int x) {
    const Vector3d p = pixels.at(x + 0.5, y + 0.5);
    return Vector3d(p.x(), p.y(), height(p) - mean);
  };
  const auto normal = [&](int y, int x) {
    const Vector3d p = pixels.at(x + 0.5, y + 0.5);
    return Vector3d(p.x() / kRadius, p.y() / kRadius, height(p) / kRadius);
  };
  const StereoLights lights = near_lights();
  const MemoryStack stack = near_capture(kSize, kSize, lights.near, {point, normal});
  ShapeOptions once;
  once.max_rounds = 1;
  const auto worst = [&](const Shape& shape) {
    double most = 0.0;
    for (int y = 0; y < kSize; ++y) {
      for (int x = 0; x < kSize; ++x) {
        most = std::max(most,
                        degrees_between(vector_at(shape.surface.normal, y, x), normal(y, x)));
      }
    }
    return most;
  };
  const double first = worst(recover_shape(stack, lights, pixels, {}, once));
  ShapeOptions options;
  options.tolerance = 1e-7;
  const Shape shape = recover_shape(stack, lights, pixels, {}, options);
  EXPECT_TRUE(shape.is_settled);
  std::printf("cap: worst normal %.3f degrees on the plane's points, %.4f after %zu rounds\n",
              first, worst(shape), shape.changes.size());
  EXPECT_LT(worst(shape), 0.1 * first);
  EXPECT_LT(worst(shape), 0.02);
  for (std::size_t i = 1; i < shape.changes.size(); ++i) {
    EXPECT_LT(shape.changes[i], 0.5 * shape.changes[i - 1]);
  }
  for (int y = 0; y < kSize; y += 7) {
    for (int x = 0; x < kSize; x += 7) {
      EXPECT_NEAR(shape.height(y, x), point(y, x).z(), 0.02);
      EXPECT_NEAR(shape.points(y, x, 2), shape.height(y, x), 1e-4);
    }
  }
}

TEST(NearAlternation, ACameraSeesTheSameFlatPaper) {
  CameraModel camera;
  camera.width = 48;
  camera.height = 36;
  camera.fx = camera.fy = 50.0;
  camera.cx = 24.0;
  camera.cy = 18.0;
  camera.world_from_cam = look_at({0, -350, 450}, {0, 0, 0}, {0, 1, 0});
  const PixelPoints pixels = PixelPoints::on_plane(camera, Vector3d::UnitZ(), 0.0);
  const StereoLights lights = near_lights();
  const MemoryStack stack =
      near_capture(48, 36, lights.near,
                   {[&](int y, int x) { return pixels.at(x + 0.5, y + 0.5); },
                    [](int, int) { return Vector3d(Vector3d::UnitZ()); }});
  const Shape shape = recover_shape(stack, lights, pixels, {});
  EXPECT_TRUE(shape.is_settled);
  const double width = (pixels.at(0, 18) - pixels.at(48, 18)).norm();
  EXPECT_LT(shape.bow_mm / width, 1e-5);
  EXPECT_LT((vector_at(shape.points, 5, 40) - pixels.at(40.5, 5.5)).norm(), 0.01);
}

}  // namespace
}  // namespace haarlight::relight
