// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/disk_visibility.h"

#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/soft_shadow/circular_segment.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kEps = std::numeric_limits<double>::epsilon();

TEST(CircularSegment, IsThatOfTheAngleToAllDigits) {
  // (theta - sin theta)/(2 pi) by mpmath in 60 digits.
  constexpr std::array<std::pair<double, double>, 6> kTruth{
      {{1e-5, 2.6525823848516593509e-17},
       {0.49999, 0.0032743324030056349728},
       {0.5, 0.0032745272325944689693},
       {1.0, 0.025230676391313442614},
       {3.0, 0.45500488242379002846},
       {6.28, 0.99999999914272013722}}};
  for (const auto& [theta, v] : kTruth) {
    // The plain difference, from 0.5 on, loses 6/theta^2 = 24 roundings at most.
    EXPECT_NEAR(segment_fraction(theta), v, 30.0 * kEps * v) << theta;
  }
  EXPECT_EQ(segment_fraction(0.0), 0.0);
  EXPECT_NEAR(segment_fraction(1e-100), 1e-300 / (12.0 * std::numbers::pi), 1e-315);
}

TEST(CircularSegment, IsThatOfTheHeightToAllDigits) {
  // V(t), theta = 4 asin(sqrt t), by mpmath in 60 digits.
  constexpr std::array<std::pair<double, double>, 14> kTruth{
      {{1e-30, 1.6976527263135502482e-45},
       {1e-15, 5.3684492911452821267e-23},
       {1e-10, 1.6976527262626206664e-15},
       {1e-8, 1.6976527212205920602e-12},
       {1e-6, 1.6976522170176414084e-9},
       {1e-4, 1.6976017958222686545e-6},
       {1e-2, 0.0016925506380167316495},
       {0.0153, 0.0031980297288320241111},
       {0.0156, 0.0032922496506396160297},
       {0.1, 0.052044019330913929311},
       {0.3, 0.25231578773434547301},
       {0.75, 0.80449889052211467904},
       {0.9, 0.94795598066908607069},
       {0.999999, 0.99999999830234778298}}};
  for (const auto& [t, v] : kTruth) {
    EXPECT_NEAR(segment_fraction_of_height(t), v, 1e-14 * v) << t;  // as the header says
  }
  EXPECT_EQ(segment_fraction_of_height(0.0), 0.0);
  EXPECT_NEAR(segment_fraction_of_height(0.5), 0.5, 0.5 * kEps);
  EXPECT_EQ(segment_fraction_of_height(1.0), 1.0);
}

TEST(CircularSegment, IsSymmetricToTheLastBit) {
  for (std::uint64_t i = 0; i < 1000; ++i) {
    const double t = 0.5 + 0.5 * uniform_unit(hash_key(17, i));  // 1 - t is exact
    EXPECT_EQ(segment_fraction_of_height(t), 1.0 - segment_fraction_of_height(1.0 - t)) << t;
  }
}

TEST(CircularSegment, ArccosLosesTheDigitsNearItsEnd) {
  const auto by_arccos = [](double t) {
    return (std::acos(1.0 - 2.0 * t) - 2.0 * (1.0 - 2.0 * t) * std::sqrt(t * (1.0 - t))) /
           std::numbers::pi;
  };
  EXPECT_NEAR(by_arccos(0.1), segment_fraction_of_height(0.1), 1e-15);
  EXPECT_GT(std::abs(by_arccos(1e-8) / segment_fraction_of_height(1e-8) - 1.0), 1e-3);
  EXPECT_GT(std::abs(by_arccos(1e-10) / segment_fraction_of_height(1e-10) - 1.0), 1.0);
}

TEST(CircularSegment, BeyondALineIsOneMinusItBeforeTheLine) {
  for (int i = -100; i <= 100; ++i) {
    const double s = i / 100.0;
    EXPECT_NEAR(segment_fraction_beyond(s) + segment_fraction_beyond(-s), 1.0, 2.0 * kEps) << s;
    EXPECT_NEAR(segment_fraction_beyond(s),
                (std::acos(s) - s * std::sqrt(1.0 - s * s)) / std::numbers::pi, 4.0 * kEps);
  }
  // 1 - s is exact there: no digit is lost for a line close to the rim. By mpmath in 60 digits.
  EXPECT_NEAR(segment_fraction_beyond(1.0 - 0x1p-33), 7.5390925781522414525e-16, 1e-29);
  EXPECT_EQ(segment_fraction_beyond(1.0), 0.0);
  EXPECT_EQ(segment_fraction_beyond(-1.0), 1.0);
}

TEST(CircularSegment, RefusesWhatIsBeyondTheDisk) {
  for (const double bad : {-1e-300, 1.0 + kEps, kInfinity, kNan}) {
    EXPECT_THROW((void)segment_fraction_of_height(bad), ContractViolation) << bad;
    EXPECT_THROW((void)disk_visibility(bad, VisibilityForm::linear), ContractViolation) << bad;
  }
  for (const double bad : {-1.0 - kEps, 1.0 + kEps, kInfinity, kNan}) {
    EXPECT_THROW((void)segment_fraction_beyond(bad), ContractViolation) << bad;
  }
}

TEST(DiskVisibility, HasThreeFormsByName) {
  EXPECT_EQ(value_of<VisibilityForm>("exact"), VisibilityForm::exact);
  EXPECT_EQ(value_of<VisibilityForm>("cubic"), VisibilityForm::cubic);
  EXPECT_EQ(value_of<VisibilityForm>("linear"), VisibilityForm::linear);
  EXPECT_EQ(disk_visibility(0.25, VisibilityForm::linear), 0.25);
  EXPECT_EQ(disk_visibility(0.25, VisibilityForm::cubic), 0.15625);
  EXPECT_EQ(disk_visibility(0.25, VisibilityForm::exact), segment_fraction_of_height(0.25));
  EXPECT_THROW((void)disk_visibility(0.25, static_cast<VisibilityForm>(3)), ContractViolation);
}

TEST(DiskVisibility, CubicAndLinearAreOffByWhatIsStated) {
  struct Largest {
    double error = 0.0;
    double t = 0.0;
  };
  const auto largest = [](VisibilityForm form) {
    Largest found;
    for (int i = 0; i <= 50'000; ++i) {  // to the middle: all three are odd about it
      const double t = i / 100'000.0;
      const double error =
          std::abs(disk_visibility(t, form) - disk_visibility(t, VisibilityForm::exact));
      found = error > found.error ? Largest{error, t} : found;
    }
    return found;
  };
  // Where the derivative of the difference is 0, by mpmath; flat there, so that a step of 1e-5
  // finds the error within 1e-9.
  const Largest cubic = largest(VisibilityForm::cubic);
  EXPECT_NEAR(cubic.error, 0.03941222022, 1e-9);
  EXPECT_NEAR(cubic.t, 0.2356641316, 2e-5);
  const Largest linear = largest(VisibilityForm::linear);
  EXPECT_NEAR(linear.error, 0.05771050735, 1e-9);
  EXPECT_NEAR(linear.t, 0.1905045538, 2e-5);
}

TEST(DiskVisibility, TIsOneHalfWhereTheRayGrazesTheEdge) {
  EXPECT_EQ(t_from_umbra(5.0, 2.0, 2.0), 0.5);
  EXPECT_EQ(t_from_penumbra(5.0, 2.0, 2.0), 0.5);
}

TEST(DiskVisibility, TIsTheUmbrasAndTheLitRegionsWithinThem) {
  EXPECT_EQ(t_from_umbra(3.0, 2.0, 4.0), 0.0);
  EXPECT_EQ(t_from_umbra(4.0, 2.0, 4.0), 0.0);
  EXPECT_EQ(t_from_umbra(1.0, 2.0, 4.0), 0.0);  // before the edge's plane
  EXPECT_EQ(t_from_umbra(100.0, 2.0, kInfinity), 0.0);
  EXPECT_EQ(t_from_penumbra(3.0, 2.0, 4.0), 1.0);
  EXPECT_EQ(t_from_penumbra(1.0, 2.0, 4.0), 1.0);
  EXPECT_EQ(t_from_penumbra(100.0, 2.0, kInfinity), 1.0);
}

TEST(DiskVisibility, TIsNotClamped) {
  // A boundary before the edge's plane, as tilted edges have: 4 (6 - 3)/(2 * 3 * 2) = 1.
  EXPECT_EQ(t_from_umbra(6.0, 4.0, 3.0), 1.0);
  EXPECT_EQ(t_from_umbra(5.0, 4.0, 3.0), 4.0 / 3.0);
  EXPECT_EQ(t_from_penumbra(5.0, 4.0, 3.0), 1.0 - 4.0 / 3.0);
  EXPECT_EQ(t_from_umbra(4.0, 4.0, 3.0), kInfinity);
  EXPECT_EQ(t_from_umbra(4.0, kInfinity, 3.0), -1.0 / 6.0);
}

TEST(DiskVisibility, RefusesWhatIsNoDistance) {
  for (const double bad : {0.0, -1.0, kNan}) {
    EXPECT_THROW((void)t_from_umbra(bad, 2.0, 3.0), ContractViolation) << bad;
    EXPECT_THROW((void)t_from_umbra(4.0, 2.0, bad), ContractViolation) << bad;
    EXPECT_THROW((void)t_from_penumbra(bad, 2.0, 3.0), ContractViolation) << bad;
    EXPECT_THROW((void)t_from_penumbra(4.0, 2.0, bad), ContractViolation) << bad;
  }
  EXPECT_THROW((void)t_from_umbra(kInfinity, 2.0, 3.0), ContractViolation);
  EXPECT_THROW((void)t_from_umbra(4.0, kNan, 3.0), ContractViolation);
  for (const double bad : {-0.1, 1.1, kNan}) {
    EXPECT_THROW((void)t_of_tilted_edge(bad, 0.5), ContractViolation) << bad;
    EXPECT_THROW((void)t_of_tilted_edge(0.5, bad), ContractViolation) << bad;
  }
}

TEST(TiltedEdge, TIsThatOfTheLineThroughA) {
  // The formula as the header gives it, in long double.
  for (const double a : {1.0001, 1.5, 4.0, 1e4}) {
    for (const double t : {1e-10, 0.01, 0.3, 0.5, 0.7, 0.999}) {
      const auto big_a = static_cast<long double>(a);
      const long double y0 =
          big_a / std::sqrt(big_a * big_a - 1) * (1 - 2 * static_cast<long double>(t));
      const long double s = y0 * big_a / std::sqrt(big_a * big_a + y0 * y0);
      // k^2 of a double k = 1/A is off by eps, 1 - k^2 by eps/(1 - k^2); long double itself by
      // 1e-19 of s.
      const auto truth = static_cast<double>((1 - s) / 2);
      const double rounding = 8.0 * kEps / (1.0 - 1.0 / (a * a)) * truth + 1e-18;
      EXPECT_NEAR(t_of_tilted_edge(t, 1.0 / a), truth, rounding) << t << " " << a;
    }
  }
}

TEST(TiltedEdge, ParallelToTheLightTIsItself) {
  for (const double t : {0.0, 1e-10, 0.25, 0.5, 0.75, 1.0}) {
    EXPECT_NEAR(t_of_tilted_edge(t, 0.0), t, kEps * t);
    EXPECT_NEAR(t_of_tilted_edge(t, 0.7) + t_of_tilted_edge(1.0 - t, 0.7), 1.0, 2.0 * kEps);
  }
  EXPECT_EQ(t_of_tilted_edge(0.5, 1.0), 0.5);
  EXPECT_EQ(t_of_tilted_edge(0.25, 1.0), 0.0);  // all lines through a touch the rim or cut it
}

TEST(LineOnDisk, IsKnownForAnEdgeParallelToTheLight) {
  // From (0, 0, 2) an edge at z = 1 and y = h/2 is seen at y = h; all of it exact in double.
  for (const double h : {-1.0 + 0x1p-33, -0.5, 0.0, 0.25, 1.0 - 0x1p-33}) {
    const std::optional<DiskLine> line =
        line_on_disk({0, 0, 2}, {3, 0.5 * h, 1}, {-5, 0.5 * h, 1}, 1.0);
    ASSERT_TRUE(line.has_value());
    // From +x to -x as seen from above: the occluder, to the left, is below.
    EXPECT_EQ(line->normal, Vector2d(0, 1));
    EXPECT_EQ(line->offset, h);
    EXPECT_EQ(line_visibility(*line), segment_fraction_beyond(h));
    const std::optional<DiskLine> turned =
        line_on_disk({0, 0, 2}, {-5, 0.5 * h, 1}, {3, 0.5 * h, 1}, 1.0);
    ASSERT_TRUE(turned.has_value());
    EXPECT_EQ(turned->offset, -h);
  }
}

TEST(LineOnDisk, KeepsItsDigitsDownToASmallVisibility) {
  // t = 2^-34 = 5.8e-11 exactly; V by mpmath in 60 digits.
  const std::optional<DiskLine> line =
      line_on_disk({0, 0, 2}, {3, 0.5 * (1 - 0x1p-33), 1}, {-5, 0.5 * (1 - 0x1p-33), 1}, 1.0);
  ASSERT_TRUE(line.has_value());
  EXPECT_NEAR(line_visibility(*line), 7.5390925781522414525e-16,
              1e-12 * 7.5390925781522414525e-16);
}

TEST(LineOnDisk, GoesThroughWhatTheEdgeHides) {
  for (std::uint64_t i = 0; i < 200; ++i) {
    const auto draw = [i](std::uint64_t what) { return uniform_unit(hash_key(19, i, what)); };
    const auto draw3 = [&](std::uint64_t what, double z) {
      return Vector3d(4.0 * draw(what) - 2.0, 4.0 * draw(what + 1) - 2.0, z + draw(what + 2));
    };
    const Vector3d x = draw3(0, 3.0);
    const Vector3d v1 = draw3(3, 1.0);
    const Vector3d v2 = draw3(6, 1.0);
    const double radius = 0.1 + draw(9);
    const std::optional<DiskLine> line = line_on_disk(x, v1, v2, radius);
    ASSERT_TRUE(line.has_value());
    for (const Vector3d& v : {v1, v2}) {
      const Vector3d seen = x + (v - x) * (x.z() / (x.z() - v.z()));
      // Positions within 20 radii of a centre 0.1 in size, times 1/sin of the angle at which the
      // edge is seen: 1e-12 leaves two digits.
      EXPECT_NEAR(line->normal.dot(seen.head<2>()), line->offset * radius, 1e-12) << i;
    }
    // To the right of the edge as seen from x.
    const Vector3d right = (v1 - x).cross(v2 - v1);
    EXPECT_GT(line->normal.dot(right.head<2>()), 0.0);
  }
}

TEST(LineOnDisk, IsTheSameInAnyUnitAndTurnedAboutTheAxis) {
  const Vector3d x(0.3, -0.4, 5.0);
  const Vector3d v1(0.5, 0.2, 1.0);
  const Vector3d v2(-0.7, 0.3, 2.0);
  const std::optional<DiskLine> line = line_on_disk(x, v1, v2, 1.5);
  ASSERT_TRUE(line.has_value());
  EXPECT_EQ(line_on_disk(0x1p40 * x, 0x1p40 * v1, 0x1p40 * v2, 0x1p40 * 1.5)->offset,
            line->offset);
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(1.0, Vector3d::UnitZ()).toRotationMatrix();
  EXPECT_NEAR(line_on_disk(turn * x, turn * v1, turn * v2, 1.5)->offset, line->offset, 1e-15);
}

TEST(LineOnDisk, ParallelToTheDiskItHidesAllOrNothing) {
  // The plane of x and the edge is z = 2, and the occluder below or above it.
  const std::optional<DiskLine> below = line_on_disk({0, 0, 2}, {1, 0, 2}, {0, 1, 2}, 1.0);
  ASSERT_TRUE(below.has_value());
  EXPECT_EQ(below->offset, kInfinity);
  EXPECT_EQ(line_visibility(*below), 0.0);
  const std::optional<DiskLine> above = line_on_disk({0, 0, 2}, {0, 1, 2}, {1, 0, 2}, 1.0);
  ASSERT_TRUE(above.has_value());
  EXPECT_EQ(line_visibility(*above), 1.0);
}

TEST(LineOnDisk, IsNoneFromTheEdgesOwnLine) {
  EXPECT_FALSE(line_on_disk({0, 0, 3}, {0, 0, 1}, {0, 0, 2}, 1.0).has_value());
  EXPECT_FALSE(
      line_on_disk({0.3, 0.3, 0.3}, {0.1, 0.1, 0.1}, {0.7, 0.7, 0.7}, 1.0).has_value());
  EXPECT_FALSE(line_on_disk({0, 0, 3}, {1, 1, 1}, {1, 1, 1}, 1.0).has_value());
  // In one line but for their rounding.
  const Vector3d start(0.3, -0.2, 0.1);
  const Vector3d along(0.1, 0.7, 0.3);
  for (std::uint64_t i = 0; i < 1000; ++i) {
    const auto on_line = [&](std::uint64_t what) {
      return Vector3d(start + uniform_unit(hash_key(43, i, what)) * along);
    };
    EXPECT_FALSE(line_on_disk(on_line(0), on_line(1), on_line(2), 1.0).has_value()) << i;
  }
}

TEST(LineOnDisk, IsKnownFromFarAway) {
  using Vector3L = Eigen::Matrix<long double, 3, 1>;
  const Vector3d v1(0.5, 0.25, 1.0);
  const Vector3d v2(-0.75, 0.3125, 1.5);
  for (const double far : {1.0, 0x1p20, 0x1p40}) {
    const Vector3d x = far * Vector3d(0.51, -0.77, 4.1);
    const Vector3L v1_long = v1.cast<long double>();
    const Vector3L normal =
        (v1_long - x.cast<long double>()).cross(v2.cast<long double>() - v1_long);
    const auto truth = static_cast<double>(normal.dot(v1_long) / normal.head<2>().norm());
    const std::optional<DiskLine> line = line_on_disk(x, v1, v2, 1.0);
    ASSERT_TRUE(line.has_value());
    EXPECT_NEAR(line->offset, truth, 8.0 * kEps) << far;  // the edge's distances are about 1
  }
}

TEST(LineOnDisk, RefusesWhatIsNotInFrontAndNotFinite) {
  const Vector3d v1(0, 0, 1);
  const Vector3d v2(1, 0, 1);
  EXPECT_THROW((void)line_on_disk({0, 0, 0}, v1, v2, 1.0), ContractViolation);
  EXPECT_THROW((void)line_on_disk({0, kNan, 2}, v1, v2, 1.0), ContractViolation);
  EXPECT_THROW((void)line_on_disk({0, 1, 2}, {0, 0, kInfinity}, v2, 1.0), ContractViolation);
  for (const double bad : {0.0, -1.0, kInfinity, kNan}) {
    EXPECT_THROW((void)line_on_disk({0, 1, 2}, v1, v2, bad), ContractViolation) << bad;
  }
}

}  // namespace
}  // namespace haarlight::render
