// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shadow/predict.h"

#include <cmath>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"

namespace haarlight::relight {
namespace {

/// A penumbra of width w, centred.
double ramp(double x, double w) {
  return w == 0.0 ? (x < 0.0 ? 0.0 : 1.0) : std::fmin(1.0, std::fmax(0.0, x / w + 0.5));
}

template <class F>
double integrate(F f) {
  constexpr int kSteps = 400000;
  double sum = 0.0;
  for (int i = 0; i < kSteps; ++i) {
    const double x = -20.0 + 40.0 * (i + 0.5) / kSteps;
    sum += f(x) * f(x);
  }
  return sum * 40.0 / kSteps;
}

TEST(Predict, SpacingAndPenumbraOfTheRigOfThePaper) {
  EXPECT_DOUBLE_EQ(shadow_spacing(30.0, 150.0, 900.0), 6.0);
  EXPECT_DOUBLE_EQ(penumbra_width(28.0, 150.0, 900.0), 5.6);
  EXPECT_DOUBLE_EQ(penumbra_width_at(28.0, 150.0, 900.0, 0.0), 5.6);
  EXPECT_DOUBLE_EQ(penumbra_width_at(28.0, 150.0, 900.0, 160.0), 0.0);
  EXPECT_THROW((void)shadow_spacing(30.0, 900.0, 900.0), ContractViolation);
}

TEST(Predict, HardSunErrorIsTheIntegral) {
  for (const double sun : {0.0, 1.0, 4.0}) {
    const double error = integrate([&](double x) { return ramp(x, 5.6) - ramp(x, sun); });
    EXPECT_NEAR(hard_sun_error(5.6, sun), error, 1e-4) << sun;
  }
}

TEST(Predict, OffGridErrorIsTheIntegral) {
  // Two neighbours half a spacing away, each a ramp of the rig's own width s/d_l D.
  for (const double side : {28.0, 30.0}) {
    const double D = 6.0;
    const double W = D * side / 30.0;
    const double error = integrate([&](double x) {
      return 0.5 * (ramp(x - 0.5 * D, W) + ramp(x + 0.5 * D, W)) - ramp(x, W);
    });
    RecordProperty("off_grid_" + std::to_string(static_cast<int>(side)),
                   std::to_string(error / D));
    EXPECT_NEAR(off_grid_error(W, D), error, 1e-4 * D) << side;
  }
}

TEST(Predict, RippleVanishesWithoutAGap) {
  EXPECT_DOUBLE_EQ(gap_ripple(30.0, 30.0, 5.0, 100.0, 900.0), 0.0);
  EXPECT_NEAR(gap_ripple(28.0, 30.0, 5.0, 100.0, 900.0), 2.0 / 28.0 * 30.0 * 100.0 / 4500.0,
              1e-12);
}

}  // namespace
}  // namespace haarlight::relight
