// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/plane_offset.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight::relight {
namespace {

constexpr double kLights = 900.0;
constexpr double kNoise = 0.3;

PlaneFrame frame() {
  PlaneFrame frame;
  frame.texel_mm = 2.0;
  frame.width = 200;
  frame.height = 100;
  return frame;
}

/// On a plane at `mm`, rising by `slope` along u; the first of them on an object of any height.
std::vector<PlanePoint> points_on(double mm, double slope, double object_fraction,
                                  std::uint64_t seed) {
  constexpr int kPoints = 1000;
  std::vector<PlanePoint> points;
  for (int i = 0; i < kPoints; ++i) {
    const std::uint64_t key = hash_key(seed, static_cast<std::uint64_t>(i));
    PlanePoint point;
    point.position = {400.0 * uniform_unit(hash_key(key, 1)) - 200.0,
                      200.0 * uniform_unit(hash_key(key, 2)) - 100.0};
    point.height.mm =
        i < object_fraction * kPoints
            ? 150.0 * uniform_unit(hash_key(key, 3))
            : mm + slope * point.position.x() + kNoise * standard_normal(hash_key(key, 4));
    point.height.error_mm = kNoise;
    points.push_back(point);
  }
  return points;
}

TEST(PlaneOffset, IsThatOfMostPointsWhateverStandsOnThePlane) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    const double mm = 40.0 * uniform_unit(hash_key(seed, 5)) - 20.0;
    const double slope = 0.2 * uniform_unit(hash_key(seed, 6)) - 0.1;
    const PlaneOffset found = plane_offset(points_on(mm, slope, 0.4, seed), frame(), kLights);
    // 500 points of 0.3 mm, at 115 mm rms along u: 0.013 mm and 1.2e-4, five of each, and the few
    // points of the object that lie on the plane by chance.
    EXPECT_NEAR(found.mm, mm, 0.2) << seed;
    EXPECT_NEAR(found.tilt_deg, std::atan(std::abs(slope)) * 180.0 / std::numbers::pi, 0.1)
        << seed;
    EXPECT_NEAR(found.most_mm, std::abs(mm) + 200.0 * std::abs(slope), 0.6) << seed;
    EXPECT_DOUBLE_EQ(found.error_mm, kNoise);
  }
}

TEST(PlaneOffset, IsNoticeableBeyondItsErrorAndAFiveHundredth) {
  EXPECT_FALSE(plane_offset(points_on(0.0, 0.0, 0.4, 1), frame(), kLights).is_noticeable);
  EXPECT_FALSE(plane_offset(points_on(1.5, 0.0, 0.4, 1), frame(), kLights).is_noticeable);
  EXPECT_TRUE(plane_offset(points_on(2.5, 0.0, 0.4, 1), frame(), kLights).is_noticeable);
  EXPECT_TRUE(plane_offset(points_on(0.0, 0.03, 0.4, 1), frame(), kLights).is_noticeable);
  std::vector<PlanePoint> uncertain = points_on(2.5, 0.0, 0.4, 1);
  for (PlanePoint& point : uncertain) {
    point.height.error_mm = 1.0;
  }
  EXPECT_FALSE(plane_offset(uncertain, frame(), kLights).is_noticeable);
  EXPECT_FALSE(plane_offset({}, frame(), kLights).is_noticeable);
}

TEST(PlaneOffset, DoesNotDependOnTheOrderOfThePoints) {
  std::vector<PlanePoint> points = points_on(3.0, 0.01, 0.4, 7);
  const PlaneOffset found = plane_offset(points, frame(), kLights);
  std::reverse(points.begin(), points.end());
  EXPECT_EQ(plane_offset(points, frame(), kLights).mm, found.mm);
}

TEST(PlaneOffset, OnAPixelInShadowOrOnADarkPlateThereIsNoHeight) {
  const std::vector<float> plate(64, 1.0F);
  std::vector<double> slopes(64);
  for (std::size_t k = 0; k < slopes.size(); ++k) {
    slopes[k] = 1e-3 * (static_cast<double>(k) - 32.0);
  }
  std::vector<float> values(64, 0.7F);
  ASSERT_TRUE(height_of_lit(values, plate, slopes));
  EXPECT_NEAR(height_of_lit(values, plate, slopes)->mm, 0.0, 1e-6);
  std::fill_n(values.begin(), 20, 0.0F);
  EXPECT_FALSE(height_of_lit(values, plate, slopes));
  EXPECT_FALSE(height_of_lit(values, std::vector<float>(64, 0.0F), slopes));
}

}  // namespace
}  // namespace haarlight::relight
