// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/object_mask.h"

#include <cmath>

#include <gtest/gtest.h>

#include "core/random.h"
#include "tests/relight/shape/made_lights.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using testing::dome_directions;
using testing::far_capture;
using testing::light_array;
using testing::MadeSurface;
using testing::near_capture;

constexpr int kSize = 48;
constexpr double kWidth = 240.0;  // mm: pixels of 5 mm

double position(int i) { return (i + 0.5 - kSize / 2.0) * kWidth / kSize; }

std::uint64_t pixel_number(int y, int x) {
  return static_cast<std::uint64_t>(y) * kSize + static_cast<std::uint64_t>(x);
}

constexpr double kRadius = 50.0;

bool is_ball(int y, int x) { return std::hypot(position(x), position(y)) < kRadius; }

/// A ball whose middle lies on the plane z = 0, of the plane's own albedo.
MadeSurface ball_on_plane() {
  MadeSurface surface;
  surface.point = [](int y, int x) -> Vector3d {
    const double r2 = position(x) * position(x) + position(y) * position(y);
    return {position(x), -position(y), is_ball(y, x) ? std::sqrt(kRadius * kRadius - r2) : 0.0};
  };
  surface.normal = [surface](int y, int x) -> Vector3d {
    return is_ball(y, x) ? Vector3d(surface.point(y, x) / kRadius) : Vector3d(0.0, 0.0, 1.0);
  };
  surface.albedo = [](int) { return 0.6; };
  return surface;
}

StereoLights near_lights() {
  StereoLights lights;
  lights.are_near = true;
  lights.near = light_array(8, 80.0, 500.0, 1.0);
  for (const NearLight& light : lights.near) {
    lights.powers.push_back(light.power);
  }
  return lights;
}

/// The shadow of the ball on the plane.
bool is_shadowed(const Vector3d& point, const Vector3d& light) {
  const Vector3d way = (light - point).normalized();
  const double along = -point.dot(way);
  return along > 0.0 && (point + along * way).norm() < kRadius;
}

MemoryStack ball_capture(const StereoLights& lights, double noise) {
  const MadeSurface surface = ball_on_plane();
  MemoryStack stack = near_capture(kSize, kSize, lights.near, surface);
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      for (int k = 0; k < stack.dims().n_lights; ++k) {
        float& value = stack.at(0, y, x, k);
        if (!is_ball(y, x) &&
            is_shadowed(surface.point(y, x),
                        lights.near[static_cast<std::size_t>(k)].position_mm)) {
          value = 0.0F;
        }
        const double dice =
            uniform_unit(hash_key(5, pixel_number(y, x), static_cast<std::uint64_t>(k)));
        value *= static_cast<float>(1.0 + noise * (2.0 * dice - 1.0));
      }
    }
  }
  return stack;
}

struct Errors {
  int n_missed = 0;  ///< of the ball
  int n_inner = 0;   ///< of these, two pixels and more from its rim
  int n_plane = 0;   ///< of the plane, taken for the ball
};

Errors compare(const ObjectMask& found) {
  Errors errors;
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      errors.n_missed += is_ball(y, x) && found.mask(y, x) == 0 ? 1 : 0;
      errors.n_inner += std::hypot(position(x), position(y)) < kRadius - 2.5 * kWidth / kSize &&
                                found.mask(y, x) == 0
                            ? 1
                            : 0;
      errors.n_plane += !is_ball(y, x) && found.mask(y, x) != 0 ? 1 : 0;
    }
  }
  return errors;
}

TEST(ObjectMask, APlanesPixelsAreToldFromABallOfTheSameAlbedo) {
  const StereoLights lights = near_lights();
  const PixelPoints plane = PixelPoints::orthographic(kSize, kSize, kWidth);
  for (const double noise : {0.0, 0.02}) {
    const ObjectMask found = mask_by_plane(ball_capture(lights, noise), lights, plane);
    EXPECT_EQ(found.origin, MaskOrigin::plane);
    const Errors errors = compare(found);
    // Of 314 pixels the rim is left out, which would show some of the plane.
    EXPECT_EQ(errors.n_inner, 0) << noise;
    EXPECT_LE(errors.n_missed, 90) << noise;
    EXPECT_EQ(errors.n_plane, 0) << noise;
  }
}

TEST(ObjectMask, AnEmptyPlaneIsAllThereIs) {
  const StereoLights lights = near_lights();
  MadeSurface surface = ball_on_plane();
  surface.point = [](int y, int x) { return Vector3d(position(x), -position(y), 0.0); };
  surface.normal = [](int, int) { return Vector3d(0.0, 0.0, 1.0); };
  const MemoryStack stack = near_capture(kSize, kSize, lights.near, surface);
  const ObjectMask found =
      mask_by_plane(stack, lights, PixelPoints::orthographic(kSize, kSize, kWidth));
  EXPECT_EQ(found.origin, MaskOrigin::whole);
  EXPECT_EQ(found.n_object, kSize * kSize);
}

TEST(ObjectMask, ACaptureThatShowsNoPlaneIsAllObject) {
  const StereoLights lights = near_lights();
  MadeSurface surface = ball_on_plane();
  const Vector3d tilted = Vector3d(-0.3, 0.0, 1.0).normalized();
  surface.point = [](int y, int x) -> Vector3d {
    return {position(x), -position(y), 40.0 + 0.3 * position(x)};
  };
  surface.normal = [tilted](int, int) -> Vector3d { return Vector3d(tilted); };
  const MemoryStack stack = near_capture(kSize, kSize, lights.near, surface);
  const ObjectMask found =
      mask_by_plane(stack, lights, PixelPoints::orthographic(kSize, kSize, kWidth));
  EXPECT_GT(found.n_object, 0.9 * kSize * kSize);
}

TEST(ObjectMask, BlackAroundABallIsLeftOutAndBlackPaintOnItIsNot) {
  StereoLights lights;
  lights.directions = dome_directions(24);
  const MadeSurface surface = ball_on_plane();
  MemoryStack stack = far_capture(kSize, kSize, 3, lights.directions, surface);
  const auto paint = [](int y, int x) { return std::hypot(position(x), position(y)) < 12.0; };
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      for (int c = 0; c < 3; ++c) {
        for (int k = 0; k < 24; ++k) {
          stack.at(c, y, x, k) *= !is_ball(y, x) || paint(y, x) ? 0.01F : 1.0F;
        }
      }
    }
  }
  const ObjectMask found = mask_by_darkness(stack, lights);
  EXPECT_EQ(found.origin, MaskOrigin::darkness);
  const Errors errors = compare(found);
  EXPECT_EQ(errors.n_plane, 0);
  EXPECT_LE(errors.n_missed, 12);  // the horizon, which few lights reach
}

TEST(ObjectMask, ShadesOfGreyWithoutAGapAreAllObject) {
  StereoLights lights;
  lights.directions = dome_directions(24);
  MadeSurface surface = ball_on_plane();
  surface.normal = [](int, int) { return Vector3d(0.0, 0.0, 1.0); };
  MemoryStack stack = far_capture(kSize, kSize, 1, lights.directions, surface);
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      for (int k = 0; k < 24; ++k) {
        stack.at(0, y, x, k) *= std::exp(-6.0F * static_cast<float>(x) / kSize);
      }
    }
  }
  const ObjectMask found = mask_by_darkness(stack, lights);
  EXPECT_EQ(found.origin, MaskOrigin::whole);
  EXPECT_EQ(found.n_object, kSize * kSize);
}

}  // namespace
}  // namespace haarlight::relight
