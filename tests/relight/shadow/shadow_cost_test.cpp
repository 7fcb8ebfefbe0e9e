// SPDX-License-Identifier: Apache-2.0
/// @file
/// What a tolerance costs, in counts: shadow pictures requested, answers of an occluder. And
/// that the stated error covers the true one where an occluder tells most of the shadow.

#include <atomic>
#include <cmath>
#include <cstdio>
#include <optional>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "relight/shadow/sample_limit.h"
#include "tests/relight/shadow/shadow_scene.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using namespace shadow_scene;  // NOLINT(google-build-using-namespace): one scene's words

/// Counts its answers.
class CountedOccluder : public Occluder {
 public:
  [[nodiscard]] OccluderLook look(const Vector3d& point,
                                  const render::SquareLight& light) const override {
    ++n_asked;
    const double v = visible(point, light);
    return {v, v, v};
  }
  [[nodiscard]] std::optional<OccluderLook> look_at_all(const Vector3d& /*point*/,
                                                        const Vector3d& /*centre*/,
                                                        double /*radius_mm*/) const override {
    return std::nullopt;
  }
  [[nodiscard]] double resolution_mm() const override { return 2.0; }
  mutable std::atomic<std::int64_t> n_asked{0};

 private:
  [[nodiscard]] virtual double visible(const Vector3d& point,
                                       const render::SquareLight& light) const = 0;
};

/// The rectangle of plate_shadow(), from points below it.
class Plate final : public CountedOccluder {
  [[nodiscard]] double visible(const Vector3d& point,
                               const render::SquareLight& light) const override {
    const auto hidden = [&](Eigen::Index axis, double from, double to, double side) {
      const auto at = [&](double edge) {
        return point[axis] + (edge - point[axis]) * (kH - point.z()) / (100.0 - point.z());
      };
      const double centre = light.centre[axis];
      const double low = std::max(at(from), centre - 0.5 * side);
      const double high = std::min(at(to), centre + 0.5 * side);
      return std::max(0.0, high - low) / side;
    };
    return 1.0 -
           hidden(0, -40.0, 25.0, light.width_mm) * hidden(1, -15.0, 40.0, light.height_mm);
  }
};

/// Another answer for every light and every block, from everywhere.
class Noise final : public CountedOccluder {
  [[nodiscard]] double visible(const Vector3d& point,
                               const render::SquareLight& light) const override {
    const Vector3d at = 7919.0 * point + 104729.0 * light.centre;
    return uniform_unit(hash_key(static_cast<std::uint64_t>(std::abs(at.x())),
                                 static_cast<std::uint64_t>(std::abs(at.y()))));
  }
};

class ShadowCost : public ShadowPoints {
 protected:
  /// Pictures that count how often they are requested.
  [[nodiscard]] std::vector<SamplingPlane> counted_planes(double picture_lookups = 0.0) {
    return {{frame_,
             [this](int k) {
               ++n_pictures_;
               Visibility picture = plate_shadow(frame_, lights_[static_cast<std::size_t>(k)]);
               picture.count.n_values = 1;
               return picture;
             },
             HeightRange{100.0, 100.0}, 0.0, picture_lookups}};
  }
  /// Since the last call.
  [[nodiscard]] int n_pictures() { return std::exchange(n_pictures_, 0); }

 private:
  int n_pictures_ = 0;
};

TEST_F(ShadowCost, EachPictureIsRequestedOnceWhereAllTablesFit) {
  const std::vector<render::SurfacePoint> receivers = hills(40);
  const std::vector<Vector3d> weights = environment(Kind::smooth, lights_, 1);
  const std::uint64_t table = std::uint64_t{16} * 101 * 101;
  const auto with = [&](double tolerance, std::uint64_t n_tables, double picture_lookups) {
    PointsOptions options = few();
    options.tolerance.relative_l2 = tolerance;
    options.memory_bytes = n_tables * table;
    return shadow_at_points(receivers, counted_planes(picture_lookups), lights_, weights,
                            options);
  };
  const PointsResult exact = with(0.0, 1000, 0.0);
  EXPECT_EQ(n_pictures(), 256);
  const PointsResult found = with(0.01, 1000, 1e9);
  EXPECT_FALSE(found.report.is_exact);
  EXPECT_EQ(n_pictures(), 256);
  EXPECT_EQ(found.report.count.n_values, 256U);
  EXPECT_EQ(exact.report.count.n_values, 256U);
  EXPECT_EQ(found.report.table_bytes, 341 * table);  // 256 lights and their blocks
  // Four trees of 85 tables, of which one is kept besides the one in use.
  const PointsResult less = with(0.01, 200, 0.0);
  EXPECT_FALSE(less.report.is_exact);
  EXPECT_EQ(n_pictures(), 64 + 2 * 192);
  EXPECT_LE(less.report.table_bytes, 200 * table);
  EXPECT_EQ(less.report.count.n_values, exact.report.count.n_values);
  // Pictures that cost more than all the sums are not made twice: the exact result.
  const PointsResult costly = with(0.01, 200, 1e5);
  EXPECT_TRUE(costly.report.is_exact);
  EXPECT_EQ(n_pictures(), 256);
  EXPECT_TRUE(same_bits(costly, exact));
}

TEST_F(ShadowCost, ATryThatNoBlockMeetsCostsLittleBesideTheExactSums) {
  const std::vector<render::SurfacePoint> receivers = hills(128);
  const std::vector<Vector3d> weights = environment(Kind::smooth, lights_, 1);
  Noise noise;
  const auto with = [&](double tolerance) {
    PointsOptions options;
    options.method = ShadowMethod::hull;
    options.occluder = &noise;
    options.tolerance.relative_l2 = tolerance;
    return shadow_at_points(receivers, counted_planes(), lights_, weights, options);
  };
  const PointsResult exact = with(0.0);
  const auto n_exact = static_cast<double>(noise.n_asked.exchange(0));
  for (const double tolerance : {0.03, 0.003}) {
    (void)n_pictures();
    const PointsResult found = with(tolerance);
    EXPECT_TRUE(found.report.is_exact);
    EXPECT_TRUE(same_bits(found, exact));
    EXPECT_EQ(n_pictures(), 256);
    // The checked receivers' exact sums are used. A sixteenth of these, an eighth of all, goes
    // down whole trees: 341 nodes for 256 lights, 0.0104 of the exact answers. The others try
    // what takes at most 3/4 of the exact time, an answer for a block taken as four: 0.0220.
    EXPECT_LE(static_cast<double>(noise.n_asked.exchange(0)),
              (1.0 + 0.0104 + 0.0220) * n_exact);
  }
}

TEST_F(ShadowCost, TheStatedErrorCoversTheTrueOneUnderAnOccluder) {
  const std::vector<render::SurfacePoint> receivers = hills(100);
  const Plate plate;
  std::int64_t n_blocks = 0;
  for (const Kind kind : {Kind::sparse, Kind::coloured}) {
    const std::vector<Vector3d> weights = environment(kind, lights_, 4);
    for (const ShadowMethod method : {ShadowMethod::hull, ShadowMethod::both}) {
      PointsOptions options;
      options.method = method;
      options.occluder = &plate;
      const PointsResult exact =
          shadow_at_points(receivers, planes(), lights_, weights, options);
      const auto n_exact = static_cast<double>(plate.n_asked.exchange(0));
      for (const double tolerance : {0.03, 0.003}) {
        options.tolerance.relative_l2 = tolerance;
        const PointsResult found =
            shadow_at_points(receivers, planes(), lights_, weights, options);
        EXPECT_LE(compare(found, exact).relative_l2, found.report.relative_l2_limit)
            << static_cast<int>(kind) << " " << tolerance;
        EXPECT_LE(found.report.relative_l2_limit, tolerance);
        const auto n_asked = static_cast<double>(plate.n_asked.exchange(0));
        EXPECT_LE(n_asked, 1.1 * n_exact);
        n_blocks += found.report.is_exact ? 0 : 1;
      }
    }
  }
  EXPECT_GT(n_blocks, 4) << "blocks were not used";
}

TEST(SampleLimit, CoversTheMeanOfSkewedValues) {
  EXPECT_EQ(limit_of_mean(std::vector<double>(100, 2.5)), 2.5);
  // A symmetric sample: three standard errors.
  std::vector<double> two(100, 1.0);
  std::fill_n(two.begin(), 50, 3.0);
  EXPECT_NEAR(limit_of_mean(two), 2.0 + 3.0 * 1.0 / 10.0, 1e-12);
  // One in a hundred is not zero, exponentially distributed with mean 100: the mean is 1. Three
  // standard errors alone would be too few in more than twice as many samples.
  int n_below = 0;
  int n_below_three = 0;
  for (std::uint64_t run = 0; run < 1000; ++run) {
    std::vector<double> values(2048, 0.0);
    double mean = 0.0;
    double square = 0.0;
    for (std::uint64_t i = 0; i < values.size(); ++i) {
      if (uniform_unit(hash_key(run, i, 1)) < 0.01) {
        values[i] = -100.0 * std::log(1.0 - uniform_unit(hash_key(run, i, 2)));
      }
      mean += values[i] / 2048.0;
      square += values[i] * values[i] / 2048.0;
    }
    n_below += limit_of_mean(values) < 1.0 ? 1 : 0;
    n_below_three += mean + 3.0 * std::sqrt((square - mean * mean) / 2048.0) < 1.0 ? 1 : 0;
  }
  std::printf("limits below the mean: %d of 1000, with three standard errors %d\n", n_below,
              n_below_three);
  EXPECT_LE(2 * n_below, n_below_three);
  EXPECT_LE(n_below, 10);
}

}  // namespace
}  // namespace haarlight::relight
