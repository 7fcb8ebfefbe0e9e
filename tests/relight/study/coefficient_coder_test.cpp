// SPDX-License-Identifier: Apache-2.0
#include "relight/study/coefficient_coder.h"

#include <cmath>
#include <numeric>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight::relight {
namespace {

std::vector<float> laplacian(std::size_t n) {
  std::vector<float> values(n);
  for (std::size_t i = 0; i < n; ++i) {
    const double u = uniform_unit(hash_key(21, i)) - 0.5;
    values[i] = static_cast<float>((u < 0.0 ? 1.0 : -1.0) * std::log(1.0 - 2.0 * std::abs(u)));
  }
  return values;
}

TEST(CoefficientCoder, QuantisesWithTheCodersDeadZone) {
  std::vector<float> values = {0.59F, -0.59F, 0.61F, -0.61F, 1.49F, 1.51F, 9.0F, 9.0F};
  EXPECT_EQ(quantise_values(values, 4, 3, 1.0F), 4U);
  EXPECT_EQ(values, (std::vector<float>{0.0F, 0.0F, 1.0F, 0.0F, 1.0F, 2.0F, 9.0F, 0.0F}));
}

TEST(CoefficientCoder, ThresholdKeepsValuesAsTheyAre) {
  std::vector<float> values = {0.3F, -2.0F, 0.5F, 1.0F};
  EXPECT_EQ(threshold_values(values, 2, 2, 0.5F), 3U);
  EXPECT_EQ(values, (std::vector<float>{0.0F, -2.0F, 0.5F, 1.0F}));
}

TEST(CoefficientCoder, EmptyPlanesCostNothingAndNoiseCostsItsEntropy) {
  const std::vector<float> zeros(12800);
  EXPECT_EQ(packed_bytes(zeros, 64, 64, 1.0F, {}), 0U);
  // 256 equally likely values: 8 bits each, and no byte planes can do better.
  std::vector<float> noise(12800);
  for (std::size_t i = 0; i < noise.size(); ++i) {
    noise[i] = static_cast<float>(hash_key(4, i) % 256) - 128.0F;
  }
  const auto bytes = double(packed_bytes(noise, 64, 64, 1.0F, {}));
  EXPECT_GT(bytes, 1.00 * double(noise.size()));
  EXPECT_LT(bytes, 1.35 * double(noise.size()));  // the sign's byte is 0 or 255: one bit
}

TEST(CoefficientCoder, LargeNumbersTakeFourBytesAndStayCountable) {
  std::vector<float> values(100, 100000.0F);
  EXPECT_GT(packed_bytes(values, 10, 10, 1.0F, {}), 0U);
  EXPECT_EQ(packed_bytes(values, 10, 0, 1.0F, {}), 0U);
}

TEST(CoefficientCoder, OrderOfPixelsChangesBytesOnly) {
  std::vector<float> values(256);
  for (std::size_t p = 0; p < 256; ++p) {
    values[p] = p % 2 == 0 ? 5.0F : static_cast<float>(hash_key(8, p) % 7);
  }
  std::vector<int> order;
  for (int i = 0; i < 256; i += 2) {
    order.push_back(i);
  }
  for (int i = 1; i < 256; i += 2) {
    order.push_back(i);
  }
  EXPECT_LT(packed_bytes(values, 1, 1, 1.0F, order), packed_bytes(values, 1, 1, 1.0F, {}));
}

TEST(CoefficientCoder, HalvesKeepElevenBitsOfTheLargest) {
  std::vector<float> values = {3.0e7F, -1.0F, 0.0F, 1234.5F};
  const std::vector<float> before = values;
  round_to_halves(values);
  for (std::size_t i = 0; i < values.size(); ++i) {
    EXPECT_NEAR(values[i], before[i], std::abs(before[i]) * 0x1p-11 + 3.0e7 * 0x1p-39);
  }
  std::vector<float> again = values;
  round_to_halves(again);
  EXPECT_EQ(again, values);
  EXPECT_GT(packed_half_bytes(values), 2U);
  std::vector<float> zeros(5);
  round_to_halves(zeros);
  EXPECT_EQ(zeros, std::vector<float>(5));
}

TEST(CoefficientCurve, TellsCountAndEnergyOfAThreshold) {
  const std::vector<float> values = laplacian(20000);
  MagnitudeHistogram histogram;
  for (const float v : values) {
    histogram.add(double{v});
  }
  const CoefficientCurve curve(histogram);
  double energy = 0.0;
  for (const float v : values) {
    energy += double{v} * double{v};
  }
  EXPECT_NEAR(curve.energy() / energy, 1.0, 1e-9);
  for (const double fraction : {0.3, 0.01}) {
    const double threshold = curve.threshold_for_energy(fraction * energy);
    double below = 0.0;
    double kept = 0.0;
    for (const float v : values) {
      (std::abs(double{v}) >= threshold ? kept : below) +=
          std::abs(double{v}) >= threshold ? 1.0 : double{v} * double{v};
    }
    EXPECT_NEAR(below / (fraction * energy), 1.0, 0.01);
    EXPECT_NEAR(curve.count_from(threshold) / kept, 1.0, 0.01);
  }
  const double t = curve.threshold_for_count(500.0);
  EXPECT_NEAR(curve.count_from(t), 500.0, 1e-6);
  EXPECT_EQ(curve.threshold_for_count(1e9), 0.0);
}

TEST(CoefficientCurve, OfNothingIsNothing) {
  const CoefficientCurve curve{MagnitudeHistogram()};
  EXPECT_EQ(curve.energy(), 0.0);
  EXPECT_EQ(curve.threshold_for_energy(1.0), 0.0);
  EXPECT_EQ(curve.threshold_for_count(3.0), 0.0);
}

}  // namespace
}  // namespace haarlight::relight
