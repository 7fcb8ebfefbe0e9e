#include "relight/basis/haar.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <rapidcheck/gtest.h>

#include "core/error.h"
#include "core/pattern_inverse.h"
#include "core/random.h"
#include "tests/golden_file.h"

namespace haarlight {
namespace {

/// The golden file's sets; by value, since a range-for over a part of a temporary would dangle.
nlohmann::json golden_sets() { return test::read_golden("haar.json").at("sets"); }

TEST(HaarGolden, FileHoldsSixSets) { EXPECT_EQ(golden_sets().size(), 6U); }

template <class T>
std::vector<T> flatten(const nlohmann::json& rows) {
  std::vector<T> values;
  for (const auto& row : rows) {
    for (const auto& value : row) {
      values.push_back(value.get<T>());
    }
  }
  return values;
}

TEST(HaarGolden, IsBitExactOnIntegersInDouble) {
  for (const auto& set : golden_sets()) {
    const int n = set["n"];
    const auto input = flatten<double>(set["input"]);
    const auto coefficients = flatten<double>(set["coef"]);
    auto x = input;
    haar_forward(x, n);
    EXPECT_EQ(x, coefficients) << set["name"];
    haar_inverse(x, n);
    EXPECT_EQ(x, input) << set["name"];
  }
}

TEST(HaarGolden, HoldsInFloatTo5e7OfThePeak) {
  for (const auto& set : golden_sets()) {
    const int n = set["n"];
    const auto coefficients = flatten<double>(set["coef"]);
    const auto input = flatten<float>(set["input"]);
    double peak = 0.0;
    for (const double c : coefficients) {
      peak = std::max(peak, std::abs(c));
    }
    auto x = input;
    haar_forward(x, n);
    for (std::size_t i = 0; i < x.size(); ++i) {
      ASSERT_LE(std::abs(double{x[i]} - coefficients[i]), 5e-7 * peak)
          << set["name"] << ' ' << i;
    }
    haar_inverse(x, n);
    for (std::size_t i = 0; i < x.size(); ++i) {
      ASSERT_LE(std::abs(double{x[i]} - double{input[i]}), 5e-7 * peak) << set["name"];
    }
  }
}

TEST(HaarGolden, IntegerFormAgreesAndIsLossless) {
  for (const auto& set : golden_sets()) {
    const int n = set["n"];
    const auto input = flatten<std::int64_t>(set["input"]);
    auto x = input;
    s_transform_forward(x, n);
    EXPECT_EQ(x, flatten<std::int64_t>(set["s_transform"])) << set["name"];
    s_transform_inverse(x, n);
    EXPECT_EQ(x, input) << set["name"];
  }
}

std::vector<double> random_values(int n, std::uint64_t seed) {
  std::vector<double> x(static_cast<std::size_t>(n) * static_cast<std::size_t>(n));
  for (std::size_t i = 0; i < x.size(); ++i) {
    x[i] = 2.0 * uniform_unit(hash_key(seed, i)) - 1.0;
  }
  return x;
}

double energy(const std::vector<double>& x) {
  return std::inner_product(x.begin(), x.end(), x.begin(), 0.0);
}

RC_GTEST_PROP(HaarProperty, KeepsEnergyAndInverts, (std::uint64_t seed)) {
  const int n = 1 << *rc::gen::inRange(0, 8);
  const auto input = random_values(n, seed);
  auto x = input;
  haar_forward(x, n);
  // 2 log2(n) roundings a coefficient.
  RC_ASSERT(std::abs(energy(x) - energy(input)) <= 1e-13 * (energy(input) + 1e-300));
  haar_inverse(x, n);
  for (std::size_t i = 0; i < x.size(); ++i) {
    RC_ASSERT(std::abs(x[i] - input[i]) <= 1e-14 * n);
  }
}

RC_GTEST_PROP(HaarProperty, IsLinear, (std::uint64_t seed, int scale)) {
  const int n = 16;
  const double s = static_cast<double>(scale % 1000) / 16.0;
  auto a = random_values(n, seed);
  auto b = random_values(n, seed + 1);
  std::vector<double> sum(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    sum[i] = a[i] + s * b[i];
  }
  haar_forward(a, n);
  haar_forward(b, n);
  haar_forward(sum, n);
  for (std::size_t i = 0; i < a.size(); ++i) {
    RC_ASSERT(std::abs(sum[i] - (a[i] + s * b[i])) <= 1e-13 * (1.0 + std::abs(s)) * n);
  }
}

RC_GTEST_PROP(HaarProperty, IntegersAreExactAndDyadic, (std::uint64_t seed)) {
  const int n = 32;
  std::vector<double> input(1024);
  for (std::size_t i = 0; i < input.size(); ++i) {
    input[i] = static_cast<double>(hash_key(seed, i) & 0xffffU);
  }
  auto x = input;
  haar_forward(x, n);
  for (const double c : x) {
    RC_ASSERT(c * 32.0 == std::floor(c * 32.0));
  }
  haar_inverse(x, n);
  RC_ASSERT(x == input);
}

RC_GTEST_PROP(HaarProperty, STransformIsLossless, (std::uint64_t seed)) {
  const int n = 1 << *rc::gen::inRange(0, 7);
  std::vector<std::int32_t> input(static_cast<std::size_t>(n) * static_cast<std::size_t>(n));
  for (std::size_t i = 0; i < input.size(); ++i) {
    input[i] = static_cast<std::int32_t>(hash_key(seed, i) & 0xffffU);
  }
  auto x = input;
  s_transform_forward(x, n);
  s_transform_inverse(x, n);
  RC_ASSERT(x == input);
}

TEST(Haar, OneLightIsSixteenCoefficientsOf32x32) {
  std::vector<double> x(1024);
  x[17 * 32 + 5] = 1.0;
  haar_forward(x, 32);
  EXPECT_EQ(std::count_if(x.begin(), x.end(), [](double c) { return c != 0.0; }), 16);
}

TEST(Haar, OrderGoesFromCoarseToFine) {
  EXPECT_EQ(haar_order(4),
            (std::vector<int>{0, 1, 4, 5, 2, 3, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}));
}

TEST(Haar, PatternsCountTheSameCoefficients) {
  // core/patterns shoots wavelets by the numbers that a basis file uses.
  constexpr int kSide = 8;
  for (int index = 0; index < kSide * kSide; ++index) {
    std::vector<double> x(std::size_t{kSide} * kSide, 0.0);
    x[static_cast<std::size_t>(index)] = 1.0;
    std::vector<double> here = x;
    haar_inverse(here, kSide);
    wavelets_to_lights(kSide, x, 1);
    EXPECT_EQ(x, here);
    const Wavelet wavelet = wavelet_at(kSide, index);
    for (int k = 0; k < kSide * kSide; ++k) {
      EXPECT_EQ(here[static_cast<std::size_t>(k)],
                wavelet.sign(k / kSide, k % kSide) / static_cast<double>(wavelet.size));
    }
    lights_to_wavelets(kSide, x, 1);
    haar_forward(here, kSide);
    EXPECT_EQ(x, here);
  }
}

TEST(Haar, RefusesOtherSizes) {
  std::vector<double> x(9);
  EXPECT_THROW(haar_forward(x, 3), ContractViolation);
  EXPECT_THROW(haar_inverse(x, 4), ContractViolation);
}

}  // namespace
}  // namespace haarlight
