// SPDX-License-Identifier: Apache-2.0
#include "render/film/filter.h"

#include <cmath>

#include <gtest/gtest.h>

namespace haarlight::render {
namespace {

/// Mean over a side of the square of weight x f(offset): what a renderer sees of f along x.
template <class F>
double seen(FilterKind kind, const F& f) {
  constexpr int kN = 1 << 21;
  const PixelFilter filter(kind);
  // The whole weight is a product of two, which are equal in the middle of the square.
  const double of_other = std::sqrt(filter.sample({0.5, 0.5}).weight);
  double sum = 0.0;
  for (int i = 0; i < kN; ++i) {
    const PixelFilter::Sample sample = filter.sample({(i + 0.5) / kN, 0.5});
    sum += sample.weight / of_other * f(sample.offset.x());
  }
  return sum / kN;
}

/// The same as an integral of the filter itself, over the filter's.
template <class F>
double truth(FilterKind kind, const F& f) {
  constexpr int kN = 1'000'000;
  double sum = 0.0;
  double norm = 0.0;
  for (int i = 0; i < kN; ++i) {
    const double x = -2.0 + 4.0 * (i + 0.5) / kN;
    const double w = filter_value(kind, x);
    sum += w * f(x);
    norm += w;
  }
  return sum / norm;
}

TEST(PixelFilter, WhatIsSeenIsFiltered) {
  // Tolerances: of midpoint rules; a cell of the filter's tail has few of 2^21 points.
  for (const FilterKind kind : {FilterKind::box, FilterKind::gaussian, FilterKind::mitchell}) {
    EXPECT_NEAR(seen(kind, [](double) { return 1.0; }), 1.0, 1e-4) << to_string(kind);
    const auto wave = [](double x) { return std::cos(1.3 * x + 0.4); };
    EXPECT_NEAR(seen(kind, wave), truth(kind, wave), 1e-4) << to_string(kind);
    const auto ramp = [](double x) { return 3.0 + x; };
    EXPECT_NEAR(seen(kind, ramp), 3.0, 1e-4) << "filters are symmetric: " << to_string(kind);
    const PixelFilter filter(kind);
    const PixelFilter::Sample a = filter.sample({0.2, 0.7});
    const PixelFilter::Sample b = filter.sample({0.7, 0.2});
    EXPECT_EQ(a.offset.x(), b.offset.y());
    EXPECT_NEAR(a.weight, b.weight, 1e-14);
  }
}

TEST(PixelFilter, MitchellIsSmoothAndSumsToOneOverPixels) {
  for (const double x : {-0.5, -0.31, 0.0, 0.2, 0.5}) {
    double sum = 0.0;
    for (int i = -3; i <= 3; ++i) {
      sum += filter_value(FilterKind::mitchell, x + i);
    }
    EXPECT_NEAR(sum, 1.0, 1e-14) << x;
  }
  EXPECT_NEAR(filter_value(FilterKind::mitchell, 1.0 - 1e-9),
              filter_value(FilterKind::mitchell, 1.0 + 1e-9), 1e-8);
  EXPECT_LT(filter_value(FilterKind::mitchell, 1.5), 0.0) << "it sharpens";
}

TEST(PixelFilter, NoSampleCountsMuchMoreThanOthers) {
  for (const FilterKind kind : {FilterKind::gaussian, FilterKind::mitchell}) {
    const PixelFilter filter(kind);
    double most = 0.0;
    for (int i = 0; i < 100'000; ++i) {
      const PixelFilter::Sample sample = filter.sample({(i + 0.5) / 100'000, 0.37});
      most = std::max(most, std::abs(sample.weight));
    }
    // Of |filter| over its integral: 1 (Gaussian) and 1.28 (Mitchell) squared at most, and little
    // more within a cell.
    EXPECT_LT(most, 1.8) << to_string(kind);
  }
}

}  // namespace
}  // namespace haarlight::render
