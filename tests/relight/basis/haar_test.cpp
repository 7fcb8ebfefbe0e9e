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

// ---- grids of any sides ----

std::vector<double> transformed(const HaarGrid& grid, std::vector<double> x) {
  haar_forward(std::span(x), grid);
  return x;
}

TEST(UnbalancedHaar, IsOrthonormalForAllSmallGrids) {
  for (int rows = 1; rows <= 9; ++rows) {
    for (int cols = 1; cols <= 9; ++cols) {
      const HaarGrid grid{rows, cols};
      const auto n = static_cast<std::size_t>(grid.size());
      std::vector<std::vector<double>> columns;
      for (std::size_t i = 0; i < n; ++i) {
        std::vector<double> unit(n, 0.0);
        unit[i] = 1.0;
        columns.push_back(transformed(grid, unit));
      }
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t j = 0; j < n; ++j) {
          const double dot =
              std::inner_product(columns[i].begin(), columns[i].end(), columns[j].begin(), 0.0);
          // At most 8 steps, each with a relative error of 3 roundings.
          ASSERT_NEAR(dot, i == j ? 1.0 : 0.0, 1e-14) << rows << " x " << cols;
        }
      }
    }
  }
}

TEST(UnbalancedHaar, ThreeLightsByHand) {
  const std::vector<double> c = transformed({1, 3}, {1.0, 2.0, 3.0});
  EXPECT_NEAR(c[0], 6.0 / std::sqrt(3.0), 1e-15);
  EXPECT_NEAR(c[1], (3.0 / std::sqrt(2.0) - 3.0 * std::sqrt(2.0)) / std::sqrt(3.0), 1e-15);
  EXPECT_NEAR(c[2], -1.0 / std::sqrt(2.0), 1e-15);
  EXPECT_EQ(transformed({3, 1}, {1.0, 2.0, 3.0}), c);
}

TEST(UnbalancedHaar, AConstantIsItsMeanAlone) {
  for (const HaarGrid grid : {HaarGrid{1, 2}, {3, 5}, {17, 30}, {1, 1024}, {5, 64}, {33, 31}}) {
    const std::vector<double> c =
        transformed(grid, std::vector<double>(static_cast<std::size_t>(grid.size()), 0.25));
    // Ten steps a side at most.
    EXPECT_NEAR(c[0], 0.25 * std::sqrt(grid.size()), 1e-13);
    for (std::size_t i = 1; i < c.size(); ++i) {
      ASSERT_NEAR(c[i], 0.0, 1e-14) << grid.rows << " x " << grid.cols << ' ' << i;
    }
  }
}

TEST(UnbalancedHaar, OfAPlainGridIsThePlainTransform) {
  for (const int n : {1, 2, 8, 32}) {
    const std::vector<double> x = random_values(n, 5);
    std::vector<double> plain = x;
    haar_forward(plain, n);
    EXPECT_EQ(transformed({n, n}, x), plain);
    EXPECT_EQ(haar_order(HaarGrid{n, n}), haar_order(n));
  }
  EXPECT_EQ(haar_group_ends({32, 32}), (std::vector<int>{64, 256, 1024}));
  EXPECT_EQ(haar_group_ends({4, 4}), std::vector<int>{16});
  EXPECT_EQ(haar_group_ends({1, 1}), std::vector<int>{1});
}

TEST(UnbalancedHaar, ComesBackInBothPrecisionsAndAsIntegers) {
  for (const HaarGrid grid : {HaarGrid{17, 30}, {1, 7}, {7, 1}, {5, 5}, {48, 2}, {3, 1000}}) {
    const auto n = 2 * static_cast<std::size_t>(grid.size());  // two arrays
    std::vector<double> x(n);
    std::vector<float> f(n);
    std::vector<std::int64_t> whole(n);
    for (std::size_t i = 0; i < n; ++i) {
      x[i] = 2.0 * uniform_unit(hash_key(9, i)) - 1.0;
      f[i] = static_cast<float>(x[i]);
      whole[i] = static_cast<std::int64_t>(x[i] * 0x1p40);
    }
    auto y = x;
    auto g = f;
    auto z = whole;
    haar_forward(std::span(y), grid);
    haar_inverse(std::span(y), grid);
    haar_forward(std::span(g), grid);
    haar_inverse(std::span(g), grid);
    s_transform_forward(std::span(z), grid);
    EXPECT_NE(z, whole);
    s_transform_inverse(std::span(z), grid);
    EXPECT_EQ(z, whole);
    for (std::size_t i = 0; i < n; ++i) {
      ASSERT_NEAR(y[i], x[i], 1e-13);
      ASSERT_NEAR(g[i], f[i], 5e-6F);  // 2 x 10 steps of 2^-24 of sums up to 30 here
    }
  }
}

TEST(UnbalancedHaar, OrderIsFromCoarseToFineAndGroupsEndWithLevels) {
  const HaarGrid grid{5, 7};
  // Sides 5 x 7, 3 x 4, 2 x 2, 1 x 1: so many sums are left after each level.
  const std::vector<int> order = haar_order(grid);
  const auto is_within = [&](int i, int rows, int cols) {
    return i / grid.cols < rows && i % grid.cols < cols;
  };
  for (const auto& [rows, cols] : {std::pair(1, 1), {2, 2}, {3, 4}, {5, 7}}) {
    for (int k = 0; k < grid.size(); ++k) {
      EXPECT_EQ(is_within(order[static_cast<std::size_t>(k)], rows, cols), k < rows * cols);
    }
  }
  EXPECT_EQ(haar_group_ends(grid), std::vector<int>{35});
  EXPECT_EQ(haar_group_ends({17, 30}), (std::vector<int>{5 * 8, 9 * 15, 17 * 30}));
}

TEST(UnbalancedHaar, RefusesWhatIsNoGrid) {
  std::vector<double> x(12);
  EXPECT_THROW(haar_forward(std::span(x), HaarGrid{}), ContractViolation);
  EXPECT_THROW(haar_forward(std::span(x), HaarGrid{5, 1}), ContractViolation);
  EXPECT_THROW(haar_forward(std::span(x), HaarGrid{1, 2000}), ContractViolation);
  EXPECT_NO_THROW(haar_forward(std::span(x), HaarGrid{2, 3}));
}

}  // namespace
}  // namespace haarlight
