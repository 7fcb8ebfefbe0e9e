// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/relight/basis/haar.h"
#include "tests/extremes.h"

namespace haarlight::relight {
namespace {

using extremes::both;
using extremes::bounded;
using extremes::Cell;
using extremes::exact;
using extremes::refused;
using extremes::stated;

std::vector<double> random_values(const HaarGrid& grid) {
  std::vector<double> x(static_cast<std::size_t>(grid.size()));
  for (std::size_t i = 0; i < x.size(); ++i) {
    x[i] = 2.0 * uniform_unit(hash_key(16, i)) - 1.0;
  }
  return x;
}

std::vector<double> scaled(std::vector<double> x, double factor) {
  for (double& v : x) {
    v *= factor;
  }
  return x;
}

std::vector<double> forward(std::vector<double> x, const HaarGrid& grid) {
  haar_forward(std::span(x), grid);
  return x;
}

std::vector<double> there_and_back(std::vector<double> x, const HaarGrid& grid) {
  haar_forward(std::span(x), grid);
  haar_inverse(std::span(x), grid);
  return x;
}

double largest_difference(const std::vector<double>& a, const std::vector<double>& b) {
  double largest = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    largest = std::max(largest, std::abs(a[i] - b[i]));
  }
  return largest;
}

constexpr HaarGrid kPlain{32, 32};
constexpr HaarGrid kUnbalanced{17, 30};

Cell zeros_stay_zero(const HaarGrid& grid) {
  const std::vector<double> zeros(static_cast<std::size_t>(grid.size()), 0.0);
  EXPECT_EQ(forward(zeros, grid), zeros);
  return exact("all coefficients are 0");
}

/// Of a grid of one light the light itself.
Cell one_light_is_itself() {
  EXPECT_EQ(forward({0.3}, {1, 1}), std::vector<double>{0.3});
  return exact("1 × 1: the value itself");
}

/// Powers of two, near 1e-30 and 1e30, so that every rounding is the same.
Cell same_bits_scaled(const HaarGrid& grid) {
  const std::vector<double> x = random_values(grid);
  for (const double factor : {0x1p-100, 0x1p100}) {
    EXPECT_EQ(forward(scaled(x, factor), grid), scaled(forward(x, grid), factor));
  }
  return exact("scaled by 2^±100 (1e±30): the same bits, scaled");
}

/// In float: the sums of a grid grow by sqrt(lights).
Cell largest_floats(const HaarGrid& grid) {
  const float peak = std::numeric_limits<float>::max() / 64.0F;
  std::vector<float> x(static_cast<std::size_t>(grid.size()), peak);
  haar_forward(std::span(x), grid);
  const double truth = double{peak} * std::sqrt(static_cast<double>(grid.size()));
  return bounded(std::abs(double{x[0]} / truth - 1.0), 1e-5,
                 "float, all values 1/64 of the largest: relative error of the mean",
                 "20 roundings of 2^-24 with the square roots'");
}

Cell subnormals(const HaarGrid& grid, double bound) {
  std::vector<double> x = random_values(grid);
  for (double& v : x) {
    v = std::round(v * 1000.0) * std::numeric_limits<double>::denorm_min();
  }
  const double off = largest_difference(there_and_back(x, grid), x);
  return bounded(off / std::numeric_limits<double>::denorm_min(), bound,
                 "forward and back: error in smallest subnormals",
                 "half a unit per step, doubled by each level's sums");
}

/// One light's coefficients, and no other, are not finite.
Cell not_finite_stays_local(const HaarGrid& grid, int n_touched) {
  const std::vector<double> x = random_values(grid);
  const std::vector<double> truth = forward(x, grid);
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    std::vector<double> spoilt = x;
    spoilt[37] = bad;
    spoilt = forward(spoilt, grid);
    int n_bad = 0;
    for (std::size_t i = 0; i < x.size(); ++i) {
      n_bad += std::isfinite(spoilt[i]) ? 0 : 1;
      EXPECT_TRUE(!std::isfinite(spoilt[i]) || spoilt[i] == truth[i]);
    }
    EXPECT_EQ(n_bad, n_touched);
  }
  return stated(
      "not tested for: the " + std::to_string(n_touched) + " of " +
      std::to_string(grid.size()) +
      " coefficients that hold the light become NaN or infinite, the others keep their "
      "bits; compressing refuses such a value first");
}

// ---- the plain transform ----

EXTREMES_OF(haar, "relight/basis: Haar", "Haar transform, n × n")

EXTREME(haar, dark) { return zeros_stay_zero(kPlain); }
EXTREME(haar, one) { return one_light_is_itself(); }
EXTREME(haar, largest) {
  const HaarGrid grid{1024, 1024};
  const std::vector<double> x = random_values(grid);
  std::vector<double> larger(std::size_t{2048} * 2048);
  return both(bounded(largest_difference(there_and_back(x, grid), x), 2e-14,
                      "1024 × 1024, forward and back: error / peak",
                      "20 levels of 4 roundings of 2^-53"),
              refused("sides of 1 to 1024", [&] {
                haar_forward(std::span(larger), HaarGrid{2048, 2048});
              }));
}
EXTREME(haar, odd_size) {
  std::vector<double> x(9);
  return refused("whole arrays of rows", [&] { haar_inverse(std::span(x), HaarGrid{4, 4}); });
}
EXTREME(haar, scale) { return both(same_bits_scaled(kPlain), largest_floats(kPlain)); }
EXTREME(haar, subnormal) { return subnormals(kPlain, 64.0); }
EXTREME(haar, not_finite) { return not_finite_stays_local(kPlain, 16); }
NO_GEOMETRY(haar)
EXTREME(haar, duplicate) {
  const std::vector<double> c = forward(std::vector<double>(1024, 0.3), kPlain);
  EXPECT_EQ(c[0], 32.0 * 0.3);
  EXPECT_TRUE(std::all_of(c.begin() + 1, c.end(), [](double v) { return v == 0.0; }));
  return exact("equal lights: n times the value, and every difference 0");
}
NO_EXTREME(haar, clipped, "a value is a value; compressing counts the clipped")

// ---- grids of any sides ----

EXTREMES_OF(unbalanced, "relight/basis: Haar", "unbalanced Haar transform, rows × columns")

EXTREME(unbalanced, dark) { return zeros_stay_zero(kUnbalanced); }
EXTREME(unbalanced, one) { return one_light_is_itself(); }
EXTREME(unbalanced, largest) {
  double off = 0.0;
  for (const HaarGrid grid : {HaarGrid{1024, 1}, {1, 1024}, {1023, 1021}}) {
    const std::vector<double> x = random_values(grid);
    off = std::max(off, largest_difference(there_and_back(x, grid), x));
  }
  std::vector<double> larger(1025);
  return both(
      bounded(off, 1e-13, "1024 × 1, 1 × 1024, 1023 × 1021, forward and back: error / peak",
              "2 × 20 steps of 4 roundings of 2^-53"),
      refused("sides of 1 to 1024", [&] {
        haar_forward(std::span(larger), HaarGrid{1025, 1});
      }));
}
EXTREME(unbalanced, odd_size) {
  double off = 0.0;
  for (const HaarGrid grid : {HaarGrid{1, 7}, {7, 1}, {3, 3}, {31, 33}, {48, 2}, {3, 1000}}) {
    const std::vector<double> x = random_values(grid);
    off = std::max(off, largest_difference(there_and_back(x, grid), x));
  }
  return bounded(off, 1e-13, "1 × 7 to 3 × 1000, forward and back: error / peak",
                 "2 × 20 steps of 4 roundings of 2^-53");
}
EXTREME(unbalanced, scale) {
  return both(same_bits_scaled(kUnbalanced), largest_floats(kUnbalanced));
}
EXTREME(unbalanced, subnormal) { return subnormals(kUnbalanced, 64.0); }
EXTREME(unbalanced, not_finite) { return not_finite_stays_local(kUnbalanced, 16); }
NO_GEOMETRY(unbalanced)
EXTREME(unbalanced, duplicate) {
  double off = 0.0;
  for (const HaarGrid grid : {HaarGrid{1, 2}, {3, 5}, {17, 30}, {1, 1024}, {33, 31}}) {
    std::vector<double> c =
        forward(std::vector<double>(static_cast<std::size_t>(grid.size()), 0.25), grid);
    c[0] -= 0.25 * std::sqrt(grid.size());
    off = std::max(off, largest_difference(c, std::vector<double>(c.size(), 0.0)));
  }
  return bounded(off, 1e-13,
                 "equal lights: all but the mean are 0, absolute error of values of 0.25",
                 "10 steps per side on sums of up to 8");
}
NO_EXTREME(unbalanced, clipped, "a value is a value; compressing counts the clipped")

// ---- integers ----

EXTREMES_OF(s_transform, "relight/basis: Haar", "S-transform (integers)")

Cell lossless(const std::vector<HaarGrid>& grids, std::int64_t largest,
              const std::string& what) {
  for (const HaarGrid& grid : grids) {
    std::vector<std::int64_t> x(static_cast<std::size_t>(grid.size()));
    for (std::size_t i = 0; i < x.size(); ++i) {
      const auto up = static_cast<std::int64_t>(hash_key(5, i) % 3);
      x[i] = (up - 1) * largest;
    }
    std::vector<std::int64_t> y = x;
    s_transform_forward(y, grid);
    s_transform_inverse(y, grid);
    EXPECT_EQ(y, x);
  }
  return exact(what + ", forward and back: every bit");
}

EXTREME(s_transform, dark) { return lossless({kPlain, kUnbalanced}, 0, "zeros"); }
EXTREME(s_transform, one) { return lossless({{1, 1}}, 7, "1 × 1"); }
EXTREME(s_transform, largest) {
  std::vector<std::int64_t> larger(1025);
  return both(lossless({{1024, 1024}, {1024, 1}}, 65535, "1024 × 1024"),
              refused("sides of 1 to 1024", [&] {
                s_transform_forward(larger, HaarGrid{1025, 1});
              }));
}
EXTREME(s_transform, odd_size) {
  return lossless({{1, 7}, {7, 1}, {31, 33}, {3, 1000}}, 65535, "1 × 7 to 3 × 1000");
}
EXTREME(s_transform, scale) {
  return lossless({kPlain, kUnbalanced}, (std::int64_t{1} << 61U) - 1,
                  "values of a quarter of the type's range, ± (2^61 − 1)");
}
NO_EXTREME(s_transform, subnormal, "integers")
NO_EXTREME(s_transform, not_finite, "integers")
NO_GEOMETRY(s_transform)
EXTREME(s_transform, duplicate) {
  std::vector<std::int64_t> x(static_cast<std::size_t>(kUnbalanced.size()), 40000);
  s_transform_forward(x, kUnbalanced);
  EXPECT_EQ(x[0], 40000);
  EXPECT_TRUE(std::all_of(x.begin() + 1, x.end(), [](std::int64_t v) { return v == 0; }));
  return exact("equal lights: the value once, and every difference 0");
}
NO_EXTREME(s_transform, clipped, "a value is a value; compressing counts the clipped")

}  // namespace
}  // namespace haarlight::relight
