// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/basis/haar.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numeric>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <rapidcheck/gtest.h>

#include "core/random.h"
#include "core/rig/pattern_inverse.h"
#include "haarlight/core/error.h"
#include "tests/golden_file.h"

namespace haarlight::relight {
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
    haar_forward(x, HaarGrid{n, n});
    EXPECT_EQ(x, coefficients) << set["name"];
    haar_inverse(x, HaarGrid{n, n});
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
    haar_forward(x, HaarGrid{n, n});
    for (std::size_t i = 0; i < x.size(); ++i) {
      ASSERT_LE(std::abs(double{x[i]} - coefficients[i]), 5e-7 * peak)
          << set["name"] << ' ' << i;
    }
    haar_inverse(x, HaarGrid{n, n});
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
    s_transform_forward(x, {n, n});
    EXPECT_EQ(x, flatten<std::int64_t>(set["s_transform"])) << set["name"];
    s_transform_inverse(x, {n, n});
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
  haar_forward(x, HaarGrid{n, n});
  // 2 log2(n) roundings per coefficient.
  RC_ASSERT(std::abs(energy(x) - energy(input)) <= 1e-13 * (energy(input) + 1e-300));
  haar_inverse(x, HaarGrid{n, n});
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
  haar_forward(a, HaarGrid{n, n});
  haar_forward(b, HaarGrid{n, n});
  haar_forward(sum, HaarGrid{n, n});
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
  haar_forward(x, HaarGrid{n, n});
  for (const double c : x) {
    RC_ASSERT(c * 32.0 == std::floor(c * 32.0));
  }
  haar_inverse(x, HaarGrid{n, n});
  RC_ASSERT(x == input);
}

RC_GTEST_PROP(HaarProperty, STransformIsLossless, (std::uint64_t seed)) {
  const int n = 1 << *rc::gen::inRange(0, 7);
  std::vector<std::int64_t> input(static_cast<std::size_t>(n) * static_cast<std::size_t>(n));
  for (std::size_t i = 0; i < input.size(); ++i) {
    input[i] = static_cast<std::int64_t>(hash_key(seed, i) & 0xffffU);
  }
  auto x = input;
  s_transform_forward(x, {n, n});
  s_transform_inverse(x, {n, n});
  RC_ASSERT(x == input);
}

TEST(Haar, OneLightIsSixteenCoefficientsOf32x32) {
  std::vector<double> x(1024);
  x[17 * 32 + 5] = 1.0;
  haar_forward(x, HaarGrid{32, 32});
  EXPECT_EQ(std::count_if(x.begin(), x.end(), [](double c) { return c != 0.0; }), 16);
}

TEST(Haar, OrderGoesFromCoarseToFine) {
  EXPECT_EQ(haar_order({4, 4}),
            (std::vector<int>{0, 1, 4, 5, 2, 3, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}));
}

TEST(Haar, PatternsCountTheSameCoefficients) {
  // core/rig/patterns shoots wavelets by the numbers that a basis file uses.
  constexpr int kSide = 8;
  for (int index = 0; index < kSide * kSide; ++index) {
    std::vector<double> x(std::size_t{kSide} * kSide, 0.0);
    x[static_cast<std::size_t>(index)] = 1.0;
    std::vector<double> here = x;
    haar_inverse(here, HaarGrid{kSide, kSide});
    wavelets_to_lights(kSide, x, 1);
    EXPECT_EQ(x, here);
    const Wavelet wavelet = wavelet_at(kSide, index);
    for (int k = 0; k < kSide * kSide; ++k) {
      EXPECT_EQ(here[static_cast<std::size_t>(k)],
                wavelet.sign(k / kSide, k % kSide) / static_cast<double>(wavelet.size));
    }
    lights_to_wavelets(kSide, x, 1);
    haar_forward(here, HaarGrid{kSide, kSide});
    EXPECT_EQ(x, here);
  }
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

/// Lights [begin, end) of a side at each level, finest first, as pairing gives them.
using Groups = std::vector<std::pair<int, int>>;
std::vector<Groups> levels_by_definition(int n, std::size_t n_levels) {
  std::vector<Groups> levels(1);
  for (int i = 0; i < n; ++i) {
    levels[0].emplace_back(i, i + 1);
  }
  while (levels.size() < n_levels) {
    const Groups fine = levels.back();
    Groups& coarse = levels.emplace_back();
    for (std::size_t i = 0; i < fine.size(); i += 2) {
      coarse.emplace_back(fine[i].first, fine[std::min(i + 1, fine.size() - 1)].second);
    }
  }
  return levels;
}

/// Along a side: the sum of group `i` of the coarser level, or behind these the difference of
/// a pair of the finer: constants on the groups, of length 1, at right angles.
std::vector<long double> line_by_definition(const std::vector<Groups>& levels, std::size_t fine,
                                            std::size_t i) {
  std::vector<long double> line(levels[0].size(), 0.0L);
  const auto fill = [&line](const std::pair<int, int>& group, long double value) {
    std::fill(line.begin() + group.first, line.begin() + group.second, value);
  };
  const auto size_of = [](const std::pair<int, int>& group) {
    return static_cast<long double>(group.second - group.first);
  };
  const Groups& coarse = levels[fine + 1];
  if (i < coarse.size()) {
    fill(coarse[i], 1.0L / std::sqrt(size_of(coarse[i])));
    return line;
  }
  const auto& first = levels[fine][2 * (i - coarse.size())];
  const auto& second = levels[fine][2 * (i - coarse.size()) + 1];
  const long double a = size_of(first);
  const long double b = size_of(second);
  fill(first, std::sqrt(b / (a * (a + b))));
  fill(second, -std::sqrt(a / (b * (a + b))));
  return line;
}

/// All coefficients as sums with the patterns of [Girardi97]'s definition, in long double.
std::vector<long double> coefficients_by_definition(const HaarGrid& grid,
                                                    const std::vector<double>& x) {
  std::size_t n_levels = 1;
  for (int n = std::max(grid.rows, grid.cols); n > 1; n = (n + 1) / 2) {
    ++n_levels;
  }
  const auto along_y = levels_by_definition(grid.rows, n_levels);
  const auto along_x = levels_by_definition(grid.cols, n_levels);
  const auto cols = static_cast<std::size_t>(grid.cols);
  std::vector<long double> c(x.size(), 0.0L);
  for (std::size_t i = 0; i < x.size(); ++i) {
    // The level whose sums the index lies among, but not among the next coarser's.
    std::size_t fine = 0;
    while (fine + 2 < n_levels && i / cols < along_y[fine + 1].size() &&
           i % cols < along_x[fine + 1].size()) {
      ++fine;
    }
    if (n_levels == 1) {
      c[i] = x[i];
      continue;
    }
    const auto line_y = line_by_definition(along_y, fine, i / cols);
    const auto line_x = line_by_definition(along_x, fine, i % cols);
    for (std::size_t k = 0; k < x.size(); ++k) {
      c[i] += line_y[k / cols] * line_x[k % cols] * static_cast<long double>(x[k]);
    }
  }
  return c;
}

TEST(UnbalancedHaar, IsTheSumWithEachPatternOfTheDefinition) {
  for (const HaarGrid grid : {HaarGrid{1, 1},
                              {1, 7},
                              {7, 1},
                              {2, 3},
                              {3, 3},
                              {4, 16},
                              {17, 30},
                              {31, 33},
                              {1024, 1},
                              {1, 1024}}) {
    std::vector<double> x(static_cast<std::size_t>(grid.size()));
    double squares = 0.0;
    for (std::size_t i = 0; i < x.size(); ++i) {
      x[i] = 2.0 * uniform_unit(hash_key(21, i)) - 1.0;
      squares += x[i] * x[i];
    }
    const std::vector<long double> truth = coefficients_by_definition(grid, x);
    const std::vector<double> c = transformed(grid, x);
    double of_c = 0.0;
    for (std::size_t i = 0; i < x.size(); ++i) {
      // 2 x 10 steps at most, each of 4 roundings of values of about 1.
      ASSERT_NEAR(c[i], static_cast<double>(truth[i]), 1e-14)
          << grid.rows << " x " << grid.cols << ' ' << i;
      of_c += c[i] * c[i];
    }
    EXPECT_NEAR(of_c / squares, 1.0, 1e-14) << grid.rows << " x " << grid.cols;
    std::vector<double> back = c;
    haar_inverse(std::span(back), grid);
    for (std::size_t i = 0; i < x.size(); ++i) {
      ASSERT_NEAR(back[i], x[i], 2e-14) << grid.rows << " x " << grid.cols << ' ' << i;
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

TEST(UnbalancedHaar, OfAPlainGridHasThePlainOrder) {
  for (const int n : {1, 2, 8, 32}) {
    const std::vector<double> x = random_values(n, 5);
    // Of 2^m per side the level is the bit length of the larger index.
    std::vector<int> order(x.size());
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [n](int a, int b) {
      const auto level = [n](int i) {
        return std::bit_width(static_cast<unsigned>(std::max(i / n, i % n)));
      };
      return level(a) < level(b);
    });
    EXPECT_EQ(haar_order({n, n}), order);
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
}  // namespace haarlight::relight
