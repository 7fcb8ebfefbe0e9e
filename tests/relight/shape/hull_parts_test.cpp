// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/hull_parts.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "relight/shape/min_cut.h"
#include "relight/shape/near_alternation.h"
#include "tests/relight/shape/made_lights.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

/// Against every one of the 2^12 divisions.
TEST(BestDivision, IsTheCheapestOfAll) {
  constexpr int kHeight = 3;
  constexpr int kWidth = 4;
  for (std::uint64_t draw = 0; draw < 40; ++draw) {
    std::uint64_t n = 0;
    const auto unit = [&] {
      return static_cast<float>(uniform_unit(hash_key(11 + draw, ++n)));
    };
    TwoLabels costs{Image<float>(kHeight, kWidth, 1), Image<float>(kHeight, kWidth, 1),
                    Image<float>(kHeight, kWidth, 1), Image<float>(kHeight, kWidth, 1)};
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        costs.stays(y, x) = unit();
        costs.moves(y, x) = unit();
        costs.right(y, x) = unit() < 0.2F ? 0.0F : unit();
        costs.down(y, x) = unit() < 0.2F ? 0.0F : unit();
      }
    }
    const auto bit_of = [](int y, int x) {
      return 1U << static_cast<unsigned>(y * kWidth + x);
    };
    const auto cost = [&](unsigned moved) {
      double sum = 0.0;
      for (int y = 0; y < kHeight; ++y) {
        for (int x = 0; x < kWidth; ++x) {
          const bool is_moved = (moved & bit_of(y, x)) != 0;
          sum += double{is_moved ? costs.moves(y, x) : costs.stays(y, x)};
          if (x + 1 < kWidth && is_moved != ((moved & bit_of(y, x + 1)) != 0)) {
            sum += double{costs.right(y, x)};
          }
          if (y + 1 < kHeight && is_moved != ((moved & bit_of(y + 1, x)) != 0)) {
            sum += double{costs.down(y, x)};
          }
        }
      }
      return sum;
    };
    double least = 1e9;
    for (unsigned moved = 0; moved < 1U << 12U; ++moved) {
      least = std::min(least, cost(moved));
    }
    const Image<std::uint8_t> found = best_division(costs);
    unsigned moved = 0;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        moved |= found(y, x) != 0 ? bit_of(y, x) : 0U;
      }
    }
    EXPECT_NEAR(cost(moved), least, 1e-6) << draw;
  }
}

/// Two plates that face up, 10 and 90 mm over the plane, side by side in the picture: their
/// normals are the same and show no step. The bounds are those of a hull: close at the outline,
/// loose inside; the lower plate's do not reach up to the higher one at half of its pixels.
class TwoPlates : public ::testing::Test {
 protected:
  static constexpr int kWidth = 48;
  static constexpr int kHeight = 36;
  static constexpr double kLow = 10.0;
  static constexpr double kHigh = 90.0;

  TwoPlates() {
    camera_.width = kWidth;
    camera_.height = kHeight;
    camera_.fx = camera_.fy = 50.0;
    camera_.cx = 24.0;
    camera_.cy = 18.0;
    camera_.world_from_cam = look_at({0, -350, 450}, {0, 0, 0}, {0, 1, 0});
    lights_.are_near = true;
    lights_.near = testing::light_array(6, 150.0, 600.0, 1.0);
    for (const NearLight& light : lights_.near) {
      lights_.directions.push_back(light.position_mm.normalized());
    }
    bounds_.possible = {Image<float>(kHeight, kWidth, 1), Image<float>(kHeight, kWidth, 1)};
    bounds_.likely = bounds_.possible;
    bounds_.sigma = 0.004;  // 2 mm of some 550
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const double distance = (point(y, x) - camera_.centre_world()).norm();
        const int inside = std::min({x % 24, 23 - x % 24, y, kHeight - 1 - y});
        const double near = 2.0 + 3.0 * inside;
        // Behind the higher plate nothing is carved.
        const double far = x < 24 ? near : 150.0;
        set(bounds_.possible, y, x, distance - near - (x < 12 ? 0.0 : 100.0), distance + far);
        set(bounds_.likely, y, x, distance - near, distance + near);
      }
    }
  }

  static void set(DepthBounds& bounds, int y, int x, double low, double high) {
    bounds.low(y, x) = static_cast<float>(std::log(low));
    bounds.high(y, x) = static_cast<float>(std::log(high));
  }
  static double height(int x) { return x < 24 ? kLow : kHigh; }
  [[nodiscard]] Vector3d point(int y, int x) const {
    return PixelPoints::on_plane(camera_, Vector3d::UnitZ(), -height(x)).at(x + 0.5, y + 0.5);
  }
  [[nodiscard]] Shape recover(const HullBounds* hull, bool by_fall_off) const {
    const PixelPoints pixels = PixelPoints::on_plane(camera_, Vector3d::UnitZ(), 0.0);
    // Two paints, as the outline of a part mostly is one in the picture.
    testing::MadeSurface plates{[&](int y, int x) { return point(y, x); },
                                [](int, int) { return Vector3d(Vector3d::UnitZ()); }};
    MemoryStack stack = testing::near_capture(kWidth, kHeight, lights_.near, plates);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 24; x < kWidth; ++x) {
        for (int k = 0; k < stack.dims().n_lights; ++k) {
          stack.at(0, y, x, k) *= 0.6F;
        }
      }
    }
    ShapeOptions options;
    options.hull = hull;
    options.finds_part_heights = by_fall_off;
    return recover_shape(stack, lights_, pixels, {}, options);
  }
  [[nodiscard]] static double rms(const Shape& shape) {
    double sum = 0.0;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        sum += std::pow(double{shape.height(y, x)} - height(x), 2);
      }
    }
    return std::sqrt(sum / (kWidth * kHeight));
  }

  [[nodiscard]] static double fraction_within(const Shape& shape, double mm) {
    int n = 0;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        n += std::abs(double{shape.height(y, x)} - height(x)) < mm ? 1 : 0;
      }
    }
    return static_cast<double>(n) / (kWidth * kHeight);
  }

  CameraModel camera_;
  StereoLights lights_;
  HullBounds bounds_;
};

TEST_F(TwoPlates, StandTogetherWithoutTheHullAndApartWithIt) {
  const Shape without = recover(nullptr, true);
  EXPECT_EQ(without.parts.size(), 1U);
  EXPECT_GT(rms(without), 30.0);
  const Shape with = recover(&bounds_, true);
  ASSERT_GE(with.parts.size(), 2U);
  EXPECT_GE(with.n_divided, 1);
  // A corner of the lower plate, where the bounds allow both, may go with the higher one.
  EXPECT_GT(fraction_within(with, 3.0), 0.95);
  int n_rows = 0;
  for (int y = 0; y < kHeight; ++y) {
    n_rows += with.map.is_cut(y, 23, 0);
  }
  EXPECT_GT(n_rows, 24);
  for (const PartHeight& part : with.parts) {
    EXPECT_TRUE(part.is_known);
    EXPECT_LE(part.low_mm, part.mean_mm);
    EXPECT_LE(part.mean_mm, part.high_mm);
  }
}

TEST_F(TwoPlates, AreHeldByTheHullAlone) {
  const Shape shape = recover(&bounds_, false);
  ASSERT_EQ(shape.parts.size(), 2U);
  for (const PartHeight& part : shape.parts) {
    EXPECT_EQ(part.source, HeightSource::hull);
    const double truth = part.mean_mm < 50.0 ? kLow : kHigh;
    EXPECT_LE(part.low_mm, truth);
    EXPECT_LE(truth, part.high_mm);
  }
  // A corner of the lower plate, where the bounds allow both, may go with the higher one.
  EXPECT_GT(fraction_within(shape, 3.0), 0.95);
}

/// One tenth of the bounds is nonsense, scattered, as where thin parts are missing in a hull.
TEST_F(TwoPlates, BearFalseBounds) {
  std::uint64_t n = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      if (uniform_unit(hash_key(5, ++n)) < 0.1) {
        set(bounds_.possible, y, x, 300.0, 320.0);
      }
    }
  }
  const Shape shape = recover(&bounds_, true);
  EXPECT_GT(fraction_within(shape, 3.0), 0.9);
}

TEST_F(TwoPlates, WithBoundsThatSayNothingStayAsTheyWere) {
  const HullBounds nothing{{Image<float>(kHeight, kWidth, 1), Image<float>(kHeight, kWidth, 1)},
                           {Image<float>(kHeight, kWidth, 1), Image<float>(kHeight, kWidth, 1)},
                           0.004};
  const Shape with = recover(&nothing, true);
  const Shape without = recover(nullptr, true);
  EXPECT_EQ(with.n_divided, 0);
  EXPECT_TRUE(std::ranges::equal(with.height.pixels(), without.height.pixels()));
}

TEST(PartMoves, AreThoseThatTheClosestBoundsLeave) {
  Image<std::uint8_t> known(1, 12, 1);
  std::fill(known.pixels().begin(), known.pixels().end(), std::uint8_t{1});
  Image<float> depth(1, 12, 1);
  HullBounds bounds{{Image<float>(1, 12, 1), Image<float>(1, 12, 1)},
                    {Image<float>(1, 12, 1), Image<float>(1, 12, 1)},
                    0.01};
  for (int x = 0; x < 12; ++x) {
    bounds.possible.low(0, x) = x == 3 ? 0.2F : -1.0F;
    bounds.possible.high(0, x) = x == 7 ? 0.3F : 1.0F;
  }
  const std::vector<PartMoves> moves = part_moves(bounds, depth, find_parts(known.view()));
  ASSERT_EQ(moves.size(), 1U);
  EXPECT_TRUE(moves[0].is_known);
  // Anywhere between the closest two: the middle. Half a voxel is the search's step; a twelfth of
  // the pixels may be 6 sigmas beyond before 0.05 of the most that a pixel costs are spent.
  EXPECT_NEAR(moves[0].best, 0.25, 0.01);
  EXPECT_NEAR(moves[0].nearest, 0.2 - 0.06, 0.011);
  EXPECT_NEAR(moves[0].furthest, 0.3 + 0.06, 0.011);
}

TEST(PartMoves, OfAPartWithoutBoundsAreUnknown) {
  Image<std::uint8_t> known(2, 2, 1);
  known(0, 0) = 1;
  const HullBounds bounds{{Image<float>(2, 2, 1), Image<float>(2, 2, 1)},
                          {Image<float>(2, 2, 1), Image<float>(2, 2, 1)},
                          0.01};
  const std::vector<PartMoves> moves =
      part_moves(bounds, Image<float>(2, 2, 1), find_parts(known.view()));
  ASSERT_EQ(moves.size(), 1U);
  EXPECT_FALSE(moves[0].is_known);
}

TEST(FindParts, AreApartWhereRegionsMeet) {
  Image<std::uint8_t> known(2, 4, 1);
  std::fill(known.pixels().begin(), known.pixels().end(), std::uint8_t{1});
  Image<int> region(2, 4, 1);
  region(0, 3) = region(1, 3) = 1;
  region(0, 0) = 2;
  const Parts parts = find_parts(known.view(), &region);
  EXPECT_EQ(parts.n_parts, 3);
  EXPECT_NE(parts.label(0, 2), parts.label(0, 3));
  EXPECT_EQ(parts.label(0, 1), parts.label(1, 0));
  EXPECT_NE(parts.label(0, 0), parts.label(0, 1));
}

}  // namespace
}  // namespace haarlight::relight
