// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/analytic/plane_irradiance.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <span>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "tests/drawn_seed.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

const Vector3d kUp = Vector3d::UnitZ();

SquareLight rectangle(const Vector3d& centre, double width, double height, double mu = 1.0) {
  SquareLight light;
  light.centre = centre;
  light.width_mm = width;
  light.height_mm = height;
  light.lobe_mu = mu;
  return light;
}

double one(const SquareLight& light, const Vector3d& point, double tolerance) {
  double value = 0.0;
  PlaneIrradiance(std::span(&light, 1), kUp, 0.0, tolerance).evaluate(point, {&value, 1});
  return value;
}

/// Irradiance below the corner of a parallel rectangle x by y at height h, radiance 1: Lambert
/// [Lambert1760]; odd in x and in y, so that four corners add up wherever the point lies.
long double corner(long double x, long double y, long double h) {
  const long double a = std::hypot(x, h);
  const long double b = std::hypot(y, h);
  return 0.5L * (x / a * std::atan2(y, a) + y / b * std::atan2(x, b));
}

long double parallel(const SquareLight& light, const Vector3d& point) {
  const Vector3d way = light.centre - point;
  long double sum = 0.0L;
  for (const int s : {-1, 1}) {
    for (const int t : {-1, 1}) {
      sum += s * t *
             corner(static_cast<long double>(way.x()) + 0.5L * s * light.width_mm,
                    static_cast<long double>(way.y()) + 0.5L * t * light.height_mm, way.z());
    }
  }
  return sum;
}

/// light_irradiance() of 64 parts: lobes far narrower than the LEDs' need them.
double fine(const SquareLight& light, const Vector3d& point) {
  constexpr int kParts = 8;
  double sum = 0.0;
  for (int i = 0; i < kParts * kParts; ++i) {
    const int row = i / kParts;
    SquareLight part = light;
    part.width_mm /= kParts;
    part.height_mm /= kParts;
    part.centre += (i % kParts - 0.5 * (kParts - 1)) * part.width_mm * light.u +
                   (row - 0.5 * (kParts - 1)) * part.height_mm * light.v;
    sum += light_irradiance(part, point, kUp);
  }
  return sum;
}

/// From a hair above the plane (0.9 mm under an LED of 28 mm) to where it is a point. The four
/// corners of the reference, of 1 each, cancel: 1e-19 of them is left.
TEST(PlaneIrradiance, IsLambertsClosedForm) {
  for (const double height : {0.9, 5.0, 28.0, 100.0, 300.0, 900.0, 2500.0}) {
    for (const double offset : {0.0, 3.0, 13.9, 50.0, 400.0}) {
      const SquareLight light = rectangle({10.0, -4.0, height}, 28.0, 14.0);
      const Vector3d point(10.0 + offset, -4.0 + 0.3 * offset, 0.0);
      const auto truth = static_cast<double>(parallel(light, point));
      EXPECT_NEAR(one(light, point, 1e-12) / truth, 1.0, 2e-12 + 2e-19 / truth)
          << height << " " << offset;
      EXPECT_NEAR(one(light, point, 1e-6) / truth, 1.0, 1e-6) << height << " " << offset;
    }
  }
}

TEST(PlaneIrradiance, RefusesPositionsThatAreNotFinite) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const SquareLight light = rectangle({0.0, nan, 3.0}, 1.0, 1.0);
  EXPECT_THROW(PlaneIrradiance(std::span(&light, 1), kUp, 0.0, 1e-12), ContractViolation);
  EXPECT_THROW((void)light_irradiance(light, Vector3d::Zero(), kUp), ContractViolation);
  EXPECT_THROW(
      (void)light_irradiance(rectangle({0.0, 0.0, 3.0}, 1.0, 1.0), {nan, 0.0, 0.0}, kUp),
      ContractViolation);
}

/// Drawn lights of any size, side ratio, tilt, lobe and position, against light_irradiance(),
/// which is good to 1e-13 (polygon_light_test.cpp); cut by the plane's horizon and turned away,
/// too.
TEST(PlaneIrradiance, KeepsTheRequestedError) {
  const std::uint64_t seed = testing::drawn_seed();
  std::uint64_t n = 0;
  const auto unit = [&] { return uniform_unit(hash_key(seed, ++n)); };
  for (const double tolerance : {1e-3, 1e-6, 1e-9, 1e-12}) {
    for (int i = 0; i < 4000; ++i) {
      const double size = std::pow(10.0, 3.0 * unit() - 1.0);
      SquareLight light = rectangle(
          {1000.0 * (unit() - 0.5), 1000.0 * (unit() - 0.5), std::pow(10.0, 3.0 * unit())},
          size, size * std::pow(10.0, -unit()), unit() < 0.4 ? 1.0 : 40.0 * unit());
      const Eigen::Quaterniond turn(Eigen::AngleAxisd(
          2.5 * unit(), Vector3d(unit() - 0.5, unit() - 0.5, 0.0).normalized()));
      light.u = turn * light.u;
      light.v = turn * light.v;
      light.emits = turn * light.emits;
      const Vector3d point(1000.0 * (unit() - 0.5), 1000.0 * (unit() - 0.5), 0.0);
      const double value = one(light, point, tolerance);
      const auto corners = light_corners(light);
      if (std::any_of(corners.begin(), corners.end(),
                      [](const Vector3d& corner) { return corner.z() < 0.0; })) {
        EXPECT_EQ(value, light_irradiance(light, point, kUp)) << "cut by the horizon";
        continue;
      }
      const double truth = fine(light, point);
      if (truth < 1e-200) {
        EXPECT_LT(value, 1e-199);
        continue;
      }
      // Positions 1000 mm off are good to 1e-13 mm: both sides of the reference's parts, an
      // eighth of the light's, and how far the point lies before the light, are differences of
      // such.
      const double h = light.emits.dot(point - light.centre);
      const double rounding = 1e-12 * (1.0 + 4.0 / std::min(light.width_mm, light.height_mm) +
                                       (1.0 + light.lobe_mu) / h);
      EXPECT_LE(std::abs(value / truth - 1.0), tolerance + rounding)
          << tolerance << " mu " << light.lobe_mu << " at " << light.centre.transpose() << " h "
          << h << " size " << light.width_mm << " x " << light.height_mm << " from "
          << point.transpose();
    }
  }
}

TEST(PlaneIrradiance, TheRulesBoundHoldsForEachRuleAlone) {
  for (const double mu : {1.0, 2.0, 10.0, 40.0}) {
    for (const double ratio : {2.0, 4.0, 10.0, 30.0, 100.0}) {
      for (int n = 2; n <= PlaneIrradiance::kMaxNodes; ++n) {
        // A tolerance that this rule just keeps, so that it, or a smaller one, is taken.
        const double radius = 10.0 * std::numbers::sqrt2;
        const double bound = PlaneIrradiance::rule_error(n, radius, ratio * radius, mu, 0.0);
        if (!(bound < 1.0 && bound > 1e-13)) {
          continue;
        }
        const double distance = (1.0001 + ratio) * radius;
        for (const double angle : {0.0, 0.5, 1.0, 1.4}) {
          const SquareLight light = rectangle(
              {distance * std::sin(angle), 0.0, distance * std::cos(angle)}, 20.0, 20.0, mu);
          const double truth = fine(light, Vector3d::Zero());
          EXPECT_NEAR(one(light, Vector3d::Zero(), bound) / truth, 1.0, bound + 1e-12)
              << mu << " " << ratio << " " << n << " " << angle;
        }
      }
    }
  }
}

/// What falls on the whole plane is what the LED sends out: area 2 pi / (mu + 1) at radiance 1.
/// Rings r = h t / (1 - t) and 64 points round each; the tail beyond is where t ends.
TEST(PlaneIrradiance, AHugePlaneTakesTheWholePower) {
  for (const double mu : {1.0, 3.0}) {
    const SquareLight light = rectangle({0.0, 0.0, 900.0}, 28.0, 20.0, mu);
    const PlaneIrradiance plane(std::span(&light, 1), kUp, 0.0, 1e-9);
    constexpr int kRings = 2000;
    constexpr int kRound = 64;
    double sum = 0.0;
    for (int i = 0; i < kRings; ++i) {
      const double t = (i + 0.5) / kRings;
      const double r = 900.0 * t / (1.0 - t);
      const double dr = 900.0 / ((1.0 - t) * (1.0 - t)) / kRings;
      for (int j = 0; j < kRound; ++j) {
        const double phi = 2.0 * std::numbers::pi * (j + 0.5) / kRound;
        double e = 0.0;
        plane.evaluate({r * std::cos(phi), r * std::sin(phi), 0.0}, {&e, 1});
        sum += e * r * dr * 2.0 * std::numbers::pi / kRound;
      }
    }
    // The midpoint rule over t leaves 1e-6.
    EXPECT_NEAR(sum / (28.0 * 20.0 * 2.0 * std::numbers::pi / (mu + 1.0)), 1.0, 3e-6) << mu;
  }
}

TEST(PlaneIrradiance, MirroredLightsGiveMirroredValuesAndThoseTurnedAwayNone) {
  std::vector<SquareLight> lights = {rectangle({200.0, 130.0, 700.0}, 28.0, 28.0),
                                     rectangle({-200.0, 130.0, 700.0}, 28.0, 28.0),
                                     rectangle({0.0, 0.0, -50.0}, 28.0, 28.0),
                                     rectangle({0.0, 0.0, 50.0}, 28.0, 28.0)};
  lights[3].emits = Vector3d::UnitZ();
  const PlaneIrradiance plane(lights, kUp, 0.0, 1e-12);
  std::vector<double> right(4);
  std::vector<double> left(4);
  plane.evaluate({70.0, 20.0, 0.0}, right);
  plane.evaluate({-70.0, 20.0, 0.0}, left);
  EXPECT_NEAR(right[0] / left[1], 1.0, 1e-14);
  EXPECT_NEAR(right[1] / left[0], 1.0, 1e-14);
  EXPECT_EQ(right[2], 0.0) << "below the plane";
  EXPECT_EQ(right[3], 0.0) << "shines upwards";
}

}  // namespace
}  // namespace haarlight::render
