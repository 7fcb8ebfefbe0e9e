// SPDX-License-Identifier: Apache-2.0
/// @file
/// The rules that the exact one is compared with, segment by segment: their bounds against the exact
/// weights, their known failures, and the order of their errors.

#include "render/volume/segment_rule.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <initializer_list>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/volume/light_sum.h"
#include "render/volume/segment_kernel.h"
#include "tests/golden_file.h"

namespace haarlight::render {
namespace {

constexpr double kEpsilon = std::numeric_limits<double>::epsilon();
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::array<VolumeMode, 5> kModes = {VolumeMode::gauss, VolumeMode::series,
                                              VolumeMode::paper, VolumeMode::approximate,
                                              VolumeMode::approximate_unsliced};

double number(const nlohmann::json& value) {
  return std::strtod(value.get<std::string>().c_str(), nullptr);
}

double uniform(std::uint64_t what, std::uint64_t i) { return uniform_unit(hash_key(what, i)); }

/// Log-uniform over 24 decades; equal ends, nearly equal ones and zeros among them.
std::pair<double, double> random_depths(std::uint64_t i) {
  const double a = std::pow(10.0, 24.0 * uniform(1, i) - 12.0);
  switch (i % 10) {
    case 0:
      return {a, a};
    case 1:
      return {a, a * (1.0 + (i % 20 < 10 ? 1.0 : -1.0) *
                                std::pow(10.0, -16.0 + 15.0 * uniform(2, i)))};
    case 2:
      return i % 20 < 10 ? std::pair{a, 0.0} : std::pair{0.0, a};
    default:
      return {a, std::pow(10.0, 24.0 * uniform(3, i) - 12.0)};
  }
}

/// The largest difference for colours of 0 to 1 at the ends: linear in them, so at a corner.
double largest_difference(const EndWeights& x, const EndWeights& y) {
  const double near = x.near - y.near;
  const double far = x.far - y.far;
  return std::max({std::abs(near), std::abs(far), std::abs(near + far)});
}

TEST(SegmentRule, GaussPointsAreThoseOfTheExactKernel) {
  const auto compare = [](const GaussPoints& ours, const auto& points, const auto& weights) {
    ASSERT_EQ(ours.points.size(), points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      EXPECT_NEAR(ours.points[i], points[i], 2.0 * kEpsilon);
      EXPECT_NEAR(ours.weights[i], weights[i], 4.0 * kEpsilon);
    }
  };
  compare(gauss_points(5), segment::GaussRule<5>::kPoints, segment::GaussRule<5>::kWeights);
  compare(gauss_points(8), segment::GaussRule<8>::kPoints, segment::GaussRule<8>::kWeights);
  compare(gauss_points(10), segment::GaussRule<10>::kPoints, segment::GaussRule<10>::kWeights);
}

/// What defines the rule: exact to degree 2n - 1, and off x^(2n) by the gamma of its error.
TEST(SegmentRule, GaussPointsIntegratePowersUpToTwiceTheirNumber) {
  for (int n = 1; n <= VolumeRule::kMostPoints; ++n) {
    const GaussPoints rule = gauss_points(n);
    const auto of_power = [&](int k) {
      double sum = 0.0;
      for (std::size_t i = 0; i < rule.points.size(); ++i) {
        sum += rule.weights[i] * std::pow(rule.points[i], k);
      }
      return sum;
    };
    for (int k = 0; k < 2 * n; ++k) {
      EXPECT_NEAR(of_power(k), 1.0 / (k + 1.0), 8.0 * kEpsilon) << n << " points, x^" << k;
    }
    if (n <= 8) {  // on 0..1: (n!)^4/((2n + 1) ((2n)!)^2)
      const double gamma =
          std::exp(4.0 * std::lgamma(n + 1.0) - 2.0 * std::lgamma(2 * n + 1)) / (2.0 * n + 1.0);
      EXPECT_NEAR(1.0 / (2.0 * n + 1.0) - of_power(2 * n), gamma, 1e-6 * gamma + kEpsilon);
    }
  }
  EXPECT_THROW((void)gauss_points(0), ContractViolation);
  EXPECT_THROW((void)gauss_points(33), ContractViolation);
}

/// 1e-13: relative_bound()'s rounding, over the opacity; of a glow also over P0 = 1, at most.
TEST(SegmentRule, GaussStaysWithinItsBound) {
  double tightest = kInfinity;
  for (const int n : {1, 2, 3, 5, 8, 10, 20}) {
    for (const double depth : {0.05, 0.5, 2.0, 8.0}) {
      const VolumeRule options{.mode = VolumeMode::gauss, .points = n, .piece_depth = depth};
      const SegmentRule rule(options);
      for (std::uint64_t i = 0; i < 250; ++i) {
        const double scale = std::pow(10.0, 5.0 * uniform(4, i) - 3.0);
        const double a = i % 7 == 0 ? 0.0 : scale * uniform(5, i);
        const double b = i % 7 == 1 ? 0.0 : scale * uniform(6, i);
        const RuledWeights ours = rule.of_depths(a, b);
        const SegmentWeights exact = weights_of_depths(a, b);
        const RuleCounts counts{.linear_peak = ours.peak};
        const double of_k =
            relative_bound(options, Glow::chromaticity, counts).value_or(kInfinity);
        const double of_g = relative_bound(options, Glow::own, counts).value_or(kInfinity);
        const double off =
            largest_difference(ours.weights.of_chromaticity, exact.of_chromaticity);
        EXPECT_LE(off, of_k * exact.opacity) << n << " " << depth << ": " << a << " " << b;
        EXPECT_LE(largest_difference(ours.weights.of_glow, exact.of_glow), of_g)
            << n << " " << depth << ": " << a << " " << b;
        if (off > 1e-11 * exact.opacity) {
          tightest = std::min(tightest, of_k * exact.opacity / off);
        }
        EXPECT_LE(ours.n_pieces, 2 + static_cast<int>(42.0 / depth)) << a << " " << b;
      }
    }
  }
  std::printf("the bound is at least %.2g times the error\n", tightest);
  // No bound that says nothing: measured errors of these are 1e-15 and 1e-9.
  EXPECT_LE(gauss_bound(10, 1.0, 1, 1).of_chromaticity, 1e-12);
  EXPECT_LE(gauss_bound(5, 0.25, 1, 1).of_chromaticity, 1e-6);
  EXPECT_EQ(gauss_bound(2, 0.0, 1, 1).of_glow, 0.0);
  EXPECT_EQ(gauss_bound(2, kInfinity, 1, 1).of_glow, kInfinity);
}

/// The bound is sound: over all of double's range, and for any tolerance; and it keeps the tolerance but
/// for rounding.
TEST(SegmentRule, SeriesStaysWithinItsBoundAndItsTolerance) {
  double worst = 0.0;
  for (const double tolerance : {0.0, 1e-14, 1e-10, 1e-6, 1e-3, 0.1}) {
    const SegmentRule rule({.mode = VolumeMode::series, .tolerance = tolerance});
    const auto check = [&](double a, double b) {
      const RuledWeights ours = rule.of_depths(a, b);
      const SegmentWeights exact = weights_of_depths(a, b);
      // Below the least normal numbers digits are lost.
      constexpr double kLeast = 1e-300;
      EXPECT_LE(largest_difference(ours.weights.of_chromaticity, exact.of_chromaticity),
                ours.relative_bound * exact.opacity + kLeast)
          << tolerance << ": " << a << " " << b;
      const double p0 = exact.of_glow.near + exact.of_glow.far;
      EXPECT_LE(largest_difference(ours.weights.of_glow, exact.of_glow),
                ours.relative_bound * p0 + kLeast)
          << tolerance << ": " << a << " " << b;
      EXPECT_LE(ours.relative_bound, tolerance + 3e-14) << a << " " << b;
      if (tolerance == 0.0 && exact.opacity > kLeast) {
        worst = std::max(
            worst, largest_difference(ours.weights.of_chromaticity, exact.of_chromaticity) /
                       exact.opacity);
      }
    };
    for (std::uint64_t i = 0; i < 20000; ++i) {
      const auto [a, b] = random_depths(i);
      check(a, b);
    }
    for (const double a : {0.0, 5e-324, 1e-300, 1.0, 41.0, 44.0, 84.0, 90.0, 1e300}) {
      for (const double b : {0.0, 5e-324, 1e-300, 1.0, 41.0, 44.0, 84.0, 90.0, 1e300}) {
        check(a, b);
      }
    }
  }
  std::printf("to rounding: off by up to %.2g of the opacity\n", worst);
}

TEST(SegmentRule, SeriesTakesFewerTermsForMoreTolerance) {
  int before = std::numeric_limits<int>::max();
  for (const double tolerance : {1e-15, 1e-10, 1e-5, 1e-2}) {
    const SegmentRule rule({.mode = VolumeMode::series, .tolerance = tolerance});
    const int n_terms = rule.of_depths(30.0, 50.0).n_terms;
    EXPECT_LT(n_terms, before);
    before = n_terms;
  }
}

/// Of Rybicki's sum, absolute, e^-(pi/(2 h))^2 = 2.0e-7 for h = 0.4; of the fit, relative, as much.
constexpr double kOfFunctions = 2.1e-7;
/// Of P0, which has 2/w of two of them; and rounding of what d divides.
double off_of_paper(double a, double b) {
  return a == b ? 1e-12 : 2.0 * kOfFunctions * 2.0 / std::sqrt(2.0 * std::abs(b - a));
}

TEST(SegmentRule, ThePapersFunctionsAreOffByWhatTheyState) {
  const nlohmann::json golden = test::read_golden("volume_segment_sweep.json");
  double of_dawson = 0.0;
  double of_erfcx = 0.0;
  for (const auto& item : golden.at("functions")) {
    const double u = number(item[0]);
    const double x = kTableScale * (1.0 - u) / u;
    const double scale = 0.5 * u / kTableScale;
    if (x > 1e8) {
      continue;
    }
    const double erfcx = 2.0 / std::sqrt(std::acos(-1.0)) * scale * number(item[1]);
    const double dawson = scale * number(item[3]);
    of_erfcx = std::max(of_erfcx, std::abs(fitted_erfcx(x) - erfcx) / erfcx);
    of_dawson = std::max(of_dawson, std::abs(rybicki_dawson(x) - dawson));
  }
  std::printf("off: Dawson's integral %.2g, e^(x^2) erfc(x) %.2g of itself\n", of_dawson,
              of_erfcx);
  EXPECT_LE(of_dawson, kOfFunctions);
  EXPECT_GE(of_dawson, 1e-8);  // it is the paper's, and no better one
  EXPECT_LE(of_erfcx, kOfFunctions);
  EXPECT_GE(of_erfcx, 1e-8);
  EXPECT_FALSE(std::isfinite(rybicki_dawson(1e10)));
}

TEST(SegmentRule, ThePapersFormulasFailWhereTheyAreKnownToAndNothingElseIsWritten) {
  const SegmentRule rule({.mode = VolumeMode::paper});
  std::uint64_t not_finite = 0;
  std::uint64_t negative = 0;
  std::vector<double> off;
  constexpr std::uint64_t kCases = 100000;
  for (std::uint64_t i = 0; i < kCases; ++i) {
    const auto [a, b] = random_depths(i);
    const RuledWeights ours = rule.of_depths(a, b);
    for (const double weight :
         {ours.weights.of_chromaticity.near, ours.weights.of_chromaticity.far,
          ours.weights.of_glow.near, ours.weights.of_glow.far, ours.weights.opacity}) {
      ASSERT_TRUE(std::isfinite(weight)) << a << " " << b;
    }
    not_finite += ours.is_finite ? 0 : 1;
    negative += ours.is_negative ? 1 : 0;
    if (ours.is_finite) {
      off.push_back(largest_difference(ours.weights.of_chromaticity,
                                       weights_of_depths(a, b).of_chromaticity));
    } else {
      EXPECT_EQ(ours.weights.of_chromaticity.near, 0.5 * ours.weights.opacity);
    }
  }
  std::ranges::sort(off);
  std::printf(
      "%llu of 100000 are no numbers, %llu negative; else off by %.2g (median), %.2g (99 %%), "
      "%.2g "
      "(largest), over 1e-6: %lld\n",
      static_cast<unsigned long long>(not_finite), static_cast<unsigned long long>(negative),
      off[off.size() / 2], off[off.size() * 99 / 100], off.back(),
      static_cast<long long>(off.end() - std::ranges::upper_bound(off, 1e-6)));
  EXPECT_GE(not_finite, 100U);
  EXPECT_GE(negative, 100U);
  // Where ends differ by a tenth or more nothing else is lost.
  for (std::uint64_t i = 0; i < 3000; ++i) {
    const double a = 20.0 * uniform(7, i);
    const double b = a * (i % 2 == 0 ? 1.1 + uniform(8, i) : 0.9 * uniform(8, i));
    const RuledWeights ours = rule.of_depths(a, b);
    ASSERT_TRUE(ours.is_finite);
    EXPECT_LE(largest_difference(ours.weights.of_chromaticity,
                                 weights_of_depths(a, b).of_chromaticity),
              off_of_paper(a, b))
        << a << " " << b;
  }
  // No medium: 0/0.
  EXPECT_FALSE(rule.of_depths(0.0, 0.0).is_finite);
  EXPECT_EQ(rule.of_depths(0.0, 0.0).weights.of_glow.near, 0.5);
}

/// One ray with rho = 3 (1 + s), k from 0.2 to 0.9, cut into n segments: the error falls with n^2, as that of
/// one segment of length h is (k' h) (rho' h^2 - rho^2 h^2)/12 and more of order h^4.
TEST(SegmentRule, TheMeanColourIsOffByTheSquareOfTheLength) {
  const auto light_of = [](const auto& weights_of, int n) {
    double light = 0.0;
    double transparency = 1.0;
    for (int i = 0; i < n; ++i) {
      const double s0 = static_cast<double>(i) / n;
      const double s1 = static_cast<double>(i + 1) / n;
      const SegmentWeights w = weights_of(3.0 * (1.0 + s0) / n, 3.0 * (1.0 + s1) / n);
      light += transparency * (w.of_chromaticity.near * (0.2 + 0.7 * s0) +
                               w.of_chromaticity.far * (0.2 + 0.7 * s1));
      transparency *= w.transparency;
    }
    return light;
  };
  const double exact = light_of(weights_of_depths, 1);
  double before = 0.0;
  for (int n = 8; n <= 512; n *= 2) {
    const double off = std::abs(light_of(mean_colour_weights, n) - exact);
    if (before > 0.0) {
      EXPECT_NEAR(before / off, 4.0, 4.0 / n + 0.02) << n;
    }
    before = off;
  }
  EXPECT_LE(before, 1e-5);
}

TEST(SegmentRule, GoldenSegmentsByEachRule) {
  const nlohmann::json golden = test::read_golden("volume_segments.json");
  const SegmentRule gauss({.mode = VolumeMode::gauss, .points = 10});
  const SegmentRule series({.mode = VolumeMode::series});
  const SegmentRule paper({.mode = VolumeMode::paper});
  int n_checked = 0;
  for (const auto& item : golden.at("linear")) {
    const double length = item.at("L");
    const double a = number(item.at("rho_near")) * length;
    const double b = number(item.at("rho_far")) * length;
    const EndWeights truth{.near = number(item.at("weight_near_wm")),
                           .far = number(item.at("weight_far_wm"))};
    const double opacity = number(item.at("opacity"));
    const std::string id = item.at("id");
    const auto off = [&](const SegmentRule& rule) {
      return largest_difference(rule.of_depths(a, b).weights.of_chromaticity, truth);
    };
    EXPECT_LE(off(gauss), 1e-13 * opacity) << id;   // gauss_bound(10, 0.5): 5e-16, and rounding
    EXPECT_LE(off(series), 3e-14 * opacity) << id;  // its own bound
    EXPECT_LE(off(paper), paper.of_depths(a, b).is_finite ? off_of_paper(a, b) : opacity) << id;
    ++n_checked;
  }
  EXPECT_EQ(n_checked, 25);
}

/// The hard cases of 70 digits, all weights: no code of ours is in the truth. Weights below the normal
/// numbers have lost digits.
TEST(SegmentRule, HardCasesAreWithinTheBoundsOfSeventyDigits) {
  const nlohmann::json golden = test::read_golden("volume_segment_sweep.json");
  const VolumeRule options{.mode = VolumeMode::gauss, .points = 10};
  const SegmentRule gauss(options);
  int n_checked = 0;
  for (const auto& item : golden.at("cases")) {
    const double a = number(item[0]);
    const double b = number(item[1]);
    const EndWeights of_k{.near = number(item[2]), .far = number(item[3])};
    const EndWeights of_g{.near = number(item[4]), .far = number(item[5])};
    const double opacity = of_k.near + of_k.far;
    const double p0 = of_g.near + of_g.far;
    constexpr double kLeast = 1e-300;
    for (const double tolerance : {0.0, 1e-9, 1e-4}) {
      const SegmentRule series({.mode = VolumeMode::series, .tolerance = tolerance});
      const RuledWeights ours = series.of_depths(a, b);
      EXPECT_LE(largest_difference(ours.weights.of_chromaticity, of_k),
                ours.relative_bound * opacity + kLeast)
          << a << " " << b;
      EXPECT_LE(largest_difference(ours.weights.of_glow, of_g),
                ours.relative_bound * p0 + kLeast)
          << a << " " << b;
    }
    const RuledWeights ours = gauss.of_depths(a, b);
    const RuleCounts counts{.linear_peak = ours.peak};
    EXPECT_LE(
        largest_difference(ours.weights.of_chromaticity, of_k),
        relative_bound(options, Glow::chromaticity, counts).value_or(kInfinity) * opacity +
            kLeast)
        << a << " " << b;
    ++n_checked;
  }
  EXPECT_GT(n_checked, 400);
}

TEST(SegmentRule, EveryRuleIsSoundAtAnyDepth) {
  for (const VolumeMode mode : kModes) {
    const SegmentRule rule({.mode = mode});
    for (const double a : {0.0, 5e-324, 1e-310, 1e-300, 1e-9, 1.0, 3.0, 50.0, 1e9, 1e300}) {
      for (const double b : {0.0, 5e-324, 1e-310, 1e-300, 1e-9, 1.0, 3.0, 50.0, 1e9, 1e300}) {
        const RuledWeights ours = rule.of_depths(a, b);
        const SegmentWeights& w = ours.weights;
        for (const double weight :
             {w.of_chromaticity.near, w.of_chromaticity.far, w.of_glow.near, w.of_glow.far}) {
          EXPECT_TRUE(std::isfinite(weight)) << to_string(mode) << ": " << a << " " << b;
          EXPECT_TRUE(weight >= 0.0 || ours.is_negative)
              << to_string(mode) << ": " << a << " " << b << " " << weight;
        }
        const double depth = 0.5 * a + 0.5 * b;
        EXPECT_EQ(w.opacity, -std::expm1(-depth));
        EXPECT_EQ(w.transparency, std::exp(-depth));
        EXPECT_TRUE(ours.n_pieces >= 1 && ours.n_terms >= ours.n_pieces);
      }
    }
    const double nan = std::numeric_limits<double>::quiet_NaN();
    for (const double bad : {-1.0, nan, 1.1e300}) {
      EXPECT_THROW((void)rule.of_depths(bad, 1.0), ContractViolation);
      EXPECT_THROW((void)rule.of_depths(1.0, bad), ContractViolation);
    }
  }
  EXPECT_THROW(SegmentRule({.mode = VolumeMode::exact}), ContractViolation);
  EXPECT_THROW(SegmentRule({.mode = VolumeMode::gauss, .piece_depth = 0.0}), ContractViolation);
  EXPECT_THROW(SegmentRule({.mode = VolumeMode::gauss, .points = 33}), ContractViolation);
}

}  // namespace
}  // namespace haarlight::render
