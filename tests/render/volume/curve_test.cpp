// SPDX-License-Identifier: Apache-2.0
/// @file
/// Fields along a ray as polynomials: where they turn, and where they have a value.

#include "render/volume/curve.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight::render {
namespace {

double uniform(std::uint64_t what, std::uint64_t i) { return uniform_unit(hash_key(what, i)); }

/// A polynomial by its coefficients, that of 1 first.
double value_of(const std::vector<double>& coefficients, double s) {
  double value = 0.0;
  for (std::size_t i = coefficients.size(); i-- > 0;) {
    value = value * s + coefficients[i];
  }
  return value;
}

/// One whose slope is zero at these positions alone.
std::vector<double> turning_at(const std::vector<double>& turns) {
  std::vector<double> slope = {1.0};
  for (const double turn : turns) {
    std::vector<double> product(slope.size() + 1, 0.0);
    for (std::size_t i = 0; i < slope.size(); ++i) {
      product[i] -= turn * slope[i];
      product[i + 1] += slope[i];
    }
    slope = product;
  }
  std::vector<double> polynomial = {0.25};
  for (std::size_t i = 0; i < slope.size(); ++i) {
    polynomial.push_back(slope[i] / static_cast<double>(i + 1));
  }
  return polynomial;
}

Curve curve_of(const std::vector<double>& polynomial) {
  std::array<double, Curve::kPoints> values{};
  for (std::size_t i = 0; i < Curve::kPoints; ++i) {
    values.at(i) = value_of(polynomial, Curve::points().at(i));
  }
  return Curve::through(values, 1e-15);
}

/// Turns of all degrees, some of them outside of 0 .. 1; no two nearer than 0.04.
std::vector<double> random_turns(std::uint64_t i, std::size_t n) {
  std::vector<double> turns;
  for (std::uint64_t k = 0; turns.size() < n; ++k) {
    const double turn = -0.25 + 1.5 * uniform(k, i);
    if (std::ranges::all_of(turns, [turn](double t) { return std::abs(t - turn) > 0.04; })) {
      turns.push_back(turn);
    }
  }
  return turns;
}

TEST(Curve, TurnsAreFoundWhateverTheDegree) {
  for (std::uint64_t i = 0; i < 2000; ++i) {
    const std::size_t n = 1 + i % 7;
    const std::vector<double> turns = random_turns(i, n);
    const std::vector<double> polynomial = turning_at(turns);
    const Curve curve = curve_of(polynomial);
    std::vector<double> splits;
    curve.add_turns(splits);
    for (const double turn : turns) {
      // A slope of 1e-15/0.04^6 is rounding: it is zero somewhere within that over the slope's own slope.
      if (turn > 1e-4 && turn < 1.0 - 1e-4) {
        EXPECT_TRUE(std::ranges::any_of(
            splits, [turn](double split) { return std::abs(split - turn) < 1e-4; }))
            << i << ": " << turn;
      }
    }
  }
}

TEST(Curve, AValueIsFoundBetweenTurns) {
  int n_found = 0;
  for (std::uint64_t i = 0; i < 2000; ++i) {
    const std::vector<double> polynomial = turning_at(random_turns(i, 1 + i % 7));
    const Curve curve = curve_of(polynomial);
    std::vector<double> ends = {0.0, 1.0};
    curve.add_turns(ends);
    std::ranges::sort(ends);
    for (std::size_t k = 0; k + 1 < ends.size(); ++k) {
      const double low = curve(ends[k]);
      const double high = curve(ends[k + 1]);
      if (std::abs(high - low) < 1e-9) {
        continue;
      }
      const double value = low + uniform(100 + k, i) * (high - low);
      const double s = crossing_of(curve, value, ends[k], ends[k + 1]);
      EXPECT_GE(s, ends[k]);
      EXPECT_LE(s, ends[k + 1]);
      EXPECT_NEAR(value_of(polynomial, s), value, 2e-15);
      ++n_found;
    }
  }
  EXPECT_GT(n_found, 4000);
}

}  // namespace
}  // namespace haarlight::render
