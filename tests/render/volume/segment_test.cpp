// SPDX-License-Identifier: Apache-2.0
/// @file
/// Segments of a volume: against reference arithmetic (segment_reference.py), and what holds for all.

#include "render/volume/segment.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <initializer_list>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/volume/segment_kernel.h"
#include "tests/golden_file.h"

namespace haarlight::render {
namespace {

constexpr double kEpsilon = std::numeric_limits<double>::epsilon();

/// The first decimals of a number, rounded; below double's range 0.
double number(const nlohmann::json& value) {
  return std::strtod(value.get<std::string>().c_str(), nullptr);
}

std::array<double, 4> four(const SegmentWeights& w) {
  return {w.of_chromaticity.near, w.of_chromaticity.far, w.of_glow.near, w.of_glow.far};
}

/// Of the difference from what must come out; what is below the normal numbers counts as equal to them.
double relative(double value, double truth) {
  return std::abs(value - truth) /
         std::max(std::abs(truth), std::numeric_limits<double>::min());
}

struct Worst {
  std::array<double, 4> of_weights{};
  double of_opacity = 0.0;
  double of_transparency = 0.0;  ///< over 1 + tau
  int n_cases = 0;
};

Worst compare(const nlohmann::json& file) {
  Worst worst;
  for (const auto& item : file.at("cases")) {
    const double a = number(item[0]);
    const double b = number(item[1]);
    const SegmentWeights w = weights_of_depths(a, b);
    const std::array<double, 4> ours = four(w);
    double opacity = 0.0;
    for (std::size_t i = 0; i < ours.size(); ++i) {
      const double truth = number(item[2 + i]);
      opacity += i < 2 ? truth : 0.0;
      const double error = relative(ours[i], truth);
      EXPECT_LE(error, 1e-14) << "weight " << i << ", a " << a << ", b " << b;
      worst.of_weights[i] = std::max(worst.of_weights[i], error);
    }
    worst.of_opacity = std::max(worst.of_opacity, relative(w.opacity, opacity));
    const double of_transparency =
        relative(w.transparency, number(item[6])) / (1.0 + 0.5 * a + 0.5 * b);
    worst.of_transparency = std::max(worst.of_transparency, of_transparency);
    ++worst.n_cases;
  }
  EXPECT_LE(worst.of_opacity, 1e-14);
  EXPECT_LE(worst.of_transparency, 1e-14);
  return worst;
}

void print(const Worst& worst) {
  std::printf(
      "largest relative errors: 1 - P0 %.2g, P0 - T %.2g, P0 - P1 %.2g, P1 %.2g, "
      "opacity %.2g, T over 1 + tau %.2g\n",
      worst.of_weights[0], worst.of_weights[1], worst.of_weights[2], worst.of_weights[3],
      worst.of_opacity, worst.of_transparency);
}

/// 1e-14: an order below what is required; measured 2e-15, some ten roundings of 1.1e-16 that
/// subtractions enlarge by up to 3.
TEST(Segment, HardCasesAreThoseOfSeventyDigits) {
  const nlohmann::json golden = test::read_golden("volume_segment_sweep.json");
  const Worst worst = compare(golden);
  print(worst);
  EXPECT_GT(worst.n_cases, 400);
}

TEST(Segment, RandomCasesOverTwentyFourDecadesAreThoseOfSeventyDigits) {
  const char* path = std::getenv("HAARLIGHT_SEGMENT_CASES");
  if (path == nullptr) {
    GTEST_SKIP()
        << "HAARLIGHT_SEGMENT_CASES names no file of segment_reference.py (python3-mpmath)";
  }
  std::ifstream in(path);
  ASSERT_TRUE(in) << path;
  print(compare(nlohmann::json::parse(in)));
}

/// 1e-15, of the value or of 1: the polynomials' deviation, 1.5e-16, and some roundings.
TEST(Segment, TabulatedFunctionsAreThoseOfSixtyDigits) {
  const nlohmann::json golden = test::read_golden("volume_segment_sweep.json");
  std::array<double, 4> worst{};
  for (const auto& item : golden.at("functions")) {
    const double u = number(item[0]);
    for (const std::size_t kind : {std::size_t{0}, std::size_t{1}}) {
      const auto ours = segment::look_up(u, kind * kTableParts * kTableStride);
      const std::array<double, 2> values = {ours.phi, ours.psi};
      for (std::size_t i = 0; i < values.size(); ++i) {
        const double truth = number(item[1 + 2 * kind + i]);
        const double off = std::abs(values[i] - truth) / std::max(1.0, std::abs(truth));
        EXPECT_LE(off, 1e-15) << "u " << u << ", kind " << kind << ", function " << i;
        worst[2 * kind + i] = std::max(worst[2 * kind + i], off);
      }
    }
  }
  std::printf("off by up to: erfcx, phi %.2g, psi %.2g; Dawson, phi %.2g, psi %.2g\n", worst[0],
              worst[1], worst[2], worst[3]);
  EXPECT_GE(golden.at("functions").size(), 96U);
}

TEST(Segment, ExponentialIsThatOfTheLibrary) {
  for (int i = 0; i <= 80000; ++i) {
    const double x = 0.01 * i;
    // 3 units: 1.5 of ours and less than 1 of the library's; below the normal numbers one unit of those.
    const double truth = std::exp(-x);
    EXPECT_NEAR(segment::exp_of_minus(x), truth, 3.0 * kEpsilon * truth + 5e-324) << x;
  }
  EXPECT_EQ(segment::exp_of_minus(0.0), 1.0);
  EXPECT_EQ(segment::exp_of_minus(1e300), 0.0);
}

/// 1e-14: each of the two is held to that.
TEST(Segment, BranchesAgreeWhereTheyMeet) {
  const auto near = [](const segment::Integrals& x, const segment::Integrals& y) {
    EXPECT_LE(relative(x.near_k, y.near_k), 1e-14);
    EXPECT_LE(relative(x.far_k, y.far_k), 1e-14);
    EXPECT_LE(relative(x.near_g, y.near_g), 1e-14);
    EXPECT_LE(relative(x.far_g, y.far_g), 1e-14);
    EXPECT_LE(relative(x.transparency, y.transparency), 1e-14);
  };
  for (int i = 0; i <= 1000; ++i) {
    const double ratio = 0.001 * i;
    for (const bool is_near_larger : {false, true}) {
      const auto a = [&](double m) { return is_near_larger ? m : ratio * m; };
      const auto b = [&](double m) { return is_near_larger ? ratio * m : m; };
      SCOPED_TRACE(testing::Message() << "ratio " << ratio << " near " << is_near_larger);
      constexpr double kM1 = segment::kFivePointsUpTo;
      near(segment::by_gauss<5>(a(kM1), b(kM1)), segment::by_gauss<8>(a(kM1), b(kM1)));
      constexpr double kM2 = segment::kEightPointsUpTo;
      near(segment::by_gauss<8>(a(kM2), b(kM2)), segment::by_gauss<10>(a(kM2), b(kM2)));
      constexpr double kM3 = segment::kTenPointsUpTo;
      near(segment::by_gauss<10>(a(kM3), b(kM3)), segment::by_closed_form(a(kM3), b(kM3)));
    }
  }
}

/// Two numbers for each index, drawn one after the other.
class Depths {
 public:
  explicit Depths(double decades) : decades_(decades) {}
  [[nodiscard]] std::pair<double, double> at(std::uint64_t i) const {
    const double a = depth(hash_key(1, i));
    const double b = depth(hash_key(2, i));
    switch (i % 8) {
      case 0:
        return {a, a};
      case 1:
        return {a, 0.0};
      case 2:
        return {0.0, a};
      case 3:
        return {a, std::nextafter(a, b)};
      case 4:
        return {a, a * (1.0 + 1e-9 * uniform_unit(hash_key(3, i)))};
      default:
        return {a, b};
    }
  }

 private:
  [[nodiscard]] double depth(std::uint64_t key) const {
    return std::pow(10.0, decades_ * (2.0 * uniform_unit(key) - 1.0));
  }
  double decades_;
};

void expect_sound(double a, double b) {
  const SegmentWeights w = weights_of_depths(a, b);
  for (const double weight : four(w)) {
    EXPECT_TRUE(std::isfinite(weight) && weight >= 0.0) << weight << ", a " << a << ", b " << b;
  }
  EXPECT_EQ(w.of_chromaticity.near + w.of_chromaticity.far, w.opacity);
  EXPECT_TRUE(w.transparency >= 0.0 && w.transparency <= 1.0) << a << " " << b;
  EXPECT_NEAR(w.opacity + w.transparency, 1.0, 4.0 * kEpsilon) << a << " " << b;
  EXPECT_LE(w.of_glow.near + w.of_glow.far, 1.0 + 4.0 * kEpsilon);
}

TEST(Segment, WeightsAreFiniteNoneNegativeAndSumToTheOpacity) {
  for (const double decades : {2.0, 12.0, 299.9}) {
    const Depths depths(decades);
    for (std::uint64_t i = 0; i < 20000; ++i) {
      const auto [a, b] = depths.at(i);
      expect_sound(a, b);
    }
  }
  for (const double a : {0.0, 5e-324, 1e-310, 1e-300, 1.0, 3.0, 1e300}) {
    for (const double b : {0.0, 5e-324, 1e-310, 1e-300, 1.0, 3.0, 1e300}) {
      expect_sound(a, b);
    }
  }
}

TEST(Segment, EqualEndsAreTheHomogeneousMedium) {
  for (const double a : {1e-12, 1e-3, 0.01, 0.3, 1.0, 2.0, 2.5, 40.0, 1e5}) {
    const SegmentWeights w = weights_of_depths(a, a);
    const double alpha = -std::expm1(-a);
    EXPECT_LE(relative(w.opacity, alpha), 1e-14) << a;
    EXPECT_LE(relative(w.of_glow.near + w.of_glow.far, alpha / a), 1e-14) << a;
    // A chromaticity weighs as a glow that a multiplies.
    EXPECT_LE(relative(w.of_chromaticity.near, a * w.of_glow.near), 1e-14) << a;
    EXPECT_LE(relative(w.of_chromaticity.far, a * w.of_glow.far), 1e-14) << a;
  }
}

TEST(Segment, AnEmptySegmentShowsWhatIsBehindAndItsOwnGlow) {
  const SegmentWeights w = segment_weights(0.0, 0.0, 3.0);
  EXPECT_EQ(w.transparency, 1.0);
  EXPECT_EQ(w.opacity, 0.0);
  EXPECT_NEAR(w.of_glow.near, 0.5, kEpsilon);
  EXPECT_NEAR(w.of_glow.far, 0.5, kEpsilon);
  EXPECT_EQ(segment_weights(4.0, 7.0, 0.0).opacity, 0.0);
}

/// P0 is continuous in d through 0: the slope of P0 with b is at most 1/6 of P0.
TEST(Segment, NearlyEqualEndsTendToEqualOnes) {
  for (const double a : {2.0001, 3.0, 10.0, 1e4}) {
    const std::array<double, 4> equal = four(weights_of_depths(a, a));
    for (const double off : {1e-15, 1e-13, 1e-11, 1e-9}) {
      for (const double b : {a * (1.0 - off), a * (1.0 + off)}) {
        const std::array<double, 4> w = four(weights_of_depths(a, b));
        for (std::size_t i = 0; i < w.size(); ++i) {
          EXPECT_LE(relative(w[i], equal[i]), 1e-14 + a * off) << i << " " << a << " " << off;
        }
      }
    }
  }
}

/// C of chromaticities, or of glows times the length, at the ends.
double chromaticity(const SegmentWeights& w, double near, double far) {
  return near * w.of_chromaticity.near + far * w.of_chromaticity.far;
}
double glow(const SegmentWeights& w, double near, double far) {
  return near * w.of_glow.near + far * w.of_glow.far;
}

/// 1e-13: both sides to 1e-14 each, and the middle's depth rounds by 1.1e-16 of up to 100.
TEST(Segment, TwoPartsOfASegmentMakeTheWhole) {
  const Depths depths(2.0);
  for (std::uint64_t i = 0; i < 20000; ++i) {
    const auto [rho_near, rho_far] = depths.at(i);
    const double cut = uniform_unit(hash_key(4, i));
    const double k_near = uniform_unit(hash_key(5, i));
    const double k_far = uniform_unit(hash_key(6, i));
    const double rho_cut = (1.0 - cut) * rho_near + cut * rho_far;
    const double k_cut = (1.0 - cut) * k_near + cut * k_far;
    const SegmentWeights whole = segment_weights(rho_near, rho_far, 1.0);
    const SegmentWeights first = segment_weights(rho_near, rho_cut, cut);
    const SegmentWeights second = segment_weights(rho_cut, rho_far, 1.0 - cut);
    const double t = first.transparency;
    EXPECT_LE(
        relative(chromaticity(first, k_near, k_cut) + t * chromaticity(second, k_cut, k_far),
                 chromaticity(whole, k_near, k_far)),
        1e-13)
        << rho_near << " " << rho_far << " " << cut;
    EXPECT_LE(relative(cut * glow(first, k_near, k_cut) +
                           t * (1.0 - cut) * glow(second, k_cut, k_far),
                       glow(whole, k_near, k_far)),
              1e-13)
        << rho_near << " " << rho_far << " " << cut;
    EXPECT_LE(relative(first.transparency * second.transparency, whole.transparency),
              1e-15 * (10.0 + rho_near + rho_far));
  }
}

TEST(Segment, ManyAtOnceAreTheSameBits) {
  for (const double decades : {0.5, 2.0, 12.0, 299.9}) {
    const Depths depths(decades);
    for (const std::size_t n :
         {std::size_t{0}, std::size_t{1}, std::size_t{15}, std::size_t{5001}}) {
      std::vector<double> near;
      std::vector<double> far;
      for (std::uint64_t i = 0; i < n; ++i) {
        const auto [a, b] = depths.at(i);
        near.push_back(a);
        far.push_back(b);
      }
      for (const double m :
           {segment::kFivePointsUpTo, segment::kEightPointsUpTo, segment::kTenPointsUpTo}) {
        near.push_back(m);
        far.push_back(0.5 * m);
      }
      std::array<std::vector<double>, 5> w;
      w.fill(std::vector<double>(near.size(), -1.0));
      find_weights(near, far, {w[0], w[1], w[2], w[3], w[4]});
      for (std::size_t i = 0; i < near.size(); ++i) {
        const SegmentWeights one = weights_of_depths(near[i], far[i]);
        const std::array<double, 4> four_of_one = four(one);
        for (std::size_t k = 0; k < 4; ++k) {
          ASSERT_EQ(w[k][i], four_of_one[k]) << k << ", a " << near[i] << ", b " << far[i];
        }
        ASSERT_EQ(w[4][i], one.transparency);
      }
    }
  }
}

TEST(Segment, ManyAtOnceRefuseWhatOneDoes) {
  std::vector<double> two(2, 1.0);
  std::vector<double> one(1, 1.0);
  std::array<std::vector<double>, 5> w;
  w.fill(std::vector<double>(2, -1.0));
  EXPECT_THROW(find_weights(two, one, {w[0], w[1], w[2], w[3], w[4]}), ContractViolation);
  EXPECT_THROW(find_weights(two, two, {w[0], w[1], w[2], w[3], one}), ContractViolation);
  const std::vector<double> bad = {1.0, -1.0};
  EXPECT_THROW(find_weights(two, bad, {w[0], w[1], w[2], w[3], w[4]}), ContractViolation);
  EXPECT_EQ(w[0][0], -1.0);
}

TEST(Segment, RefusesWhatIsNoDepth) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double infinity = std::numeric_limits<double>::infinity();
  for (const double bad : {-1e-300, -1.0, 1.1e300, nan, infinity}) {
    EXPECT_THROW((void)weights_of_depths(bad, 1.0), ContractViolation) << bad;
    EXPECT_THROW((void)weights_of_depths(1.0, bad), ContractViolation) << bad;
    EXPECT_THROW((void)segment_weights(bad, 1.0, 1.0), ContractViolation) << bad;
    EXPECT_THROW((void)segment_weights(1.0, bad, 1.0), ContractViolation) << bad;
    EXPECT_THROW((void)segment_weights(1.0, 1.0, bad), ContractViolation) << bad;
  }
  EXPECT_THROW((void)segment_weights(1e200, 1.0, 1e200), ContractViolation);
}

}  // namespace
}  // namespace haarlight::render
