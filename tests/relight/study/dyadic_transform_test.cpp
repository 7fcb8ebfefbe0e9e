// SPDX-License-Identifier: Apache-2.0
#include "relight/study/dyadic_transform.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "core/random.h"
#include "relight/study/cdf53.h"

namespace haarlight::relight {
namespace {

std::vector<float> noise(std::size_t n, std::uint64_t seed) {
  std::vector<float> values(n);
  for (std::size_t i = 0; i < n; ++i) {
    values[i] = static_cast<float>(uniform_unit(hash_key(seed, i)) - 0.5);
  }
  return values;
}

/// The taps that a level of CDF 5/3 applies inside a line, from the answer to impulses.
double tap(int at, int impulse, int n) {
  const DyadicTransform line(Wavelet::cdf53, 1, n);
  std::vector<float> x(static_cast<std::size_t>(n));
  x[static_cast<std::size_t>(impulse)] = 1.0F;
  line.forward(x, 1, 0, 1);
  return double{x[static_cast<std::size_t>(at)]} /
         double{line.norms()[static_cast<std::size_t>(at)]};
}

TEST(DyadicTransform, DetailsOf53AreTheKnownFilter) {
  // Le Gall's high-pass: -1/2, 1, -1/2 around an odd point; nothing beyond.
  EXPECT_EQ(tap(15, 15, 33), 1.0);
  EXPECT_EQ(tap(15, 14, 33), -0.5);
  EXPECT_EQ(tap(15, 16, 33), -0.5);
  EXPECT_EQ(tap(15, 13, 33), 0.0);
  EXPECT_EQ(tap(15, 17, 33), 0.0);
}

TEST(DyadicTransform, MeansOf53AreTheKnownFilter) {
  // The low-pass -1/8 1/4 3/4 1/4 -1/8 shows in a detail of the next level: at position 18 that is
  // s(18) - (s(16) + s(20))/2.
  const std::vector<double> low = {-0.125, 0.25, 0.75, 0.25, -0.125};
  const int n = 33;
  for (int impulse = 8; impulse <= 28; ++impulse) {
    const auto mean = [&](int at) {
      const int i = impulse - at + 2;
      return i >= 0 && i < 5 ? low[static_cast<std::size_t>(i)] : 0.0;
    };
    EXPECT_NEAR(tap(18, impulse, n), mean(18) - 0.5 * (mean(16) + mean(20)), 1e-7) << impulse;
  }
}

TEST(DyadicTransform, DetailsOf53AreBlindToStraightLines) {
  // Two vanishing moments: away from the mirrored borders a ramp has no details.
  const int n = 65;
  const DyadicTransform line(Wavelet::cdf53, 1, n);
  std::vector<float> x(static_cast<std::size_t>(n));
  for (int i = 0; i < n; ++i) {
    x[static_cast<std::size_t>(i)] = 3.0F + 2.0F * static_cast<float>(i);
  }
  line.forward(x, 1, 0, 1);
  for (int i = 1; i < n - 1; i += 2) {
    EXPECT_EQ(x[static_cast<std::size_t>(i)], 0.0F);
  }
  std::vector<float> constant(static_cast<std::size_t>(n), 7.0F);
  line.forward(constant, 1, 0, 1);
  for (std::size_t i = 1; i < constant.size(); ++i) {
    EXPECT_EQ(constant[i], 0.0F) << i;  // borders too
  }
}

TEST(DyadicTransform, NormsAreTheLengthsOfThePatterns) {
  const DyadicTransform array(Wavelet::cdf53, 7, 12);
  for (std::size_t i = 0; i < 84; ++i) {
    std::vector<float> x(84);
    x[i] = 1.0F;
    array.inverse(x, 1, 0, 1);
    double energy = 0.0;
    for (const float v : x) {
      energy += double{v} * double{v};
    }
    EXPECT_NEAR(energy, 1.0, 1e-5) << i;
  }
}

TEST(DyadicTransform, OrderNamesEveryPlaceOnceFromCoarseToFine) {
  const DyadicTransform array(Wavelet::haar, 6, 9);
  std::vector<int> sorted(array.order().begin(), array.order().end());
  EXPECT_EQ(sorted.front(), 0);
  std::sort(sorted.begin(), sorted.end());
  for (int i = 0; i < 54; ++i) {
    EXPECT_EQ(sorted[static_cast<std::size_t>(i)], i);
  }
}

RC_GTEST_PROP(DyadicTransform, InverseUndoesForwardAtAnySize, ()) {
  const int rows = *rc::gen::inRange(1, 20);
  const int cols = *rc::gen::inRange(1, 20);
  const auto width = static_cast<std::size_t>(*rc::gen::inRange(1, 4));
  const Wavelet wavelet = *rc::gen::element(Wavelet::haar, Wavelet::cdf53);
  const DyadicTransform array(wavelet, rows, cols);
  const std::size_t n = static_cast<std::size_t>(rows * cols) * width;
  const std::vector<float> before = noise(n, 17);
  std::vector<float> x = before;
  array.forward(x, width, 0, width);
  if (wavelet == Wavelet::haar) {  // orthonormal at odd sizes too
    double energy = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
      energy += double{x[i]} * double{x[i]} - double{before[i]} * double{before[i]};
    }
    RC_ASSERT(std::abs(energy) < 1e-4);
  }
  array.inverse(x, width, 0, width);
  for (std::size_t i = 0; i < n; ++i) {
    RC_ASSERT(std::abs(x[i] - before[i]) < 4e-6F);
  }
}

RC_GTEST_PROP(DyadicTransform, PartsOfAPointAreTransformedByThemselves, ()) {
  const DyadicTransform array(Wavelet::cdf53, 6, 5);
  const std::vector<float> before = noise(90, *rc::gen::inRange<std::uint64_t>(0, 100));
  std::vector<float> whole = before;
  array.forward(whole, 3, 0, 3);
  std::vector<float> parts = before;
  array.forward(parts, 3, 2, 1);
  array.forward(parts, 3, 0, 2);
  RC_ASSERT(whole == parts);
}

TEST(Cdf53, GivesTheLightsBackAndItsPatternsHaveLengthOneButMeet) {
  for (const ArrayGrid& grid :
       {ArrayGrid{8, 8, 2}, ArrayGrid{5, 7, 3}, ArrayGrid{1, 1, 1}, ArrayGrid{1, 6, 1}}) {
    const auto basis = make_cdf53_basis(grid);
    const auto n = static_cast<std::size_t>(basis->n_lights());
    EXPECT_TRUE(basis->is_complete());
    EXPECT_EQ(basis->is_orthonormal(), n == 1);
    const std::vector<float> lights = noise(3 * n, 5);
    std::vector<float> coefficients(3 * n);
    std::vector<float> back(3 * n);
    basis->analyse(lights, coefficients);
    basis->synthesise(coefficients, back);
    for (std::size_t i = 0; i < back.size(); ++i) {
      // 2 log2(n) additions and a scale, each half an ulp of at most 1.
      EXPECT_NEAR(back[i], lights[i], 4e-6);
    }
    std::vector<float> one(n);
    std::vector<float> pattern(n);
    std::vector<float> first(n);
    double most = 0.0;  // of another pattern's product with the first
    for (std::size_t i = 0; i < n; ++i) {
      std::fill(one.begin(), one.end(), 0.0F);
      one[i] = 1.0F;
      basis->synthesise(one, pattern);
      first = i == 0 ? pattern : first;
      double energy = 0.0;
      double product = 0.0;
      for (std::size_t k = 0; k < n; ++k) {
        energy += double{pattern[k]} * double{pattern[k]};
        product += double{pattern[k]} * double{first[k]};
      }
      EXPECT_NEAR(energy, 1.0, 2e-6);
      most = i > 0 ? std::max(most, std::abs(product)) : most;
    }
    EXPECT_TRUE(n == 1 || most > 0.1);
  }
}

}  // namespace
}  // namespace haarlight::relight
