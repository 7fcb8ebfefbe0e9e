// SPDX-License-Identifier: Apache-2.0
#include "render/sampling/sampler.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <set>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "render/sampling/warp.h"

namespace haarlight::render {
namespace {

/// Whether each of the 2^k boxes of 2^-i by 2^-(k - i) holds exactly one of the 2^k points, for
/// every i: what makes them a (0, k, 2)-net in base 2.
bool is_net(const std::vector<Eigen::Vector2d>& points, int k) {
  for (int i = 0; i <= k; ++i) {
    std::set<std::pair<int, int>> boxes;
    for (const Eigen::Vector2d& p : points) {
      boxes.emplace(static_cast<int>(std::ldexp(p.x(), i)),
                    static_cast<int>(std::ldexp(p.y(), k - i)));
    }
    if (boxes.size() != points.size()) {
      return false;
    }
  }
  return true;
}

TEST(Sampler, SobolPairsAreNetsWheneverTheirNumberIsAPowerOfTwo) {
  for (std::uint32_t dimension = 0; dimension < 20; ++dimension) {
    const PixelSamples samples(SamplerKind::sobol, 7, 3, static_cast<int>(dimension));
    for (const int k : {1, 4, 8, 11}) {
      for (const std::uint32_t block :
           {0U, 5U}) {  // any such run of samples, not the first only
        std::vector<Eigen::Vector2d> points;
        for (std::uint32_t i = 0; i < (1U << static_cast<unsigned>(k)); ++i) {
          points.push_back(samples.two((block << static_cast<unsigned>(k)) + i, dimension));
        }
        EXPECT_TRUE(is_net(points, k)) << dimension << ' ' << k << ' ' << block;
      }
    }
  }
}

TEST(Sampler, StratifiedSamplesAreOneInEachStratum) {
  for (std::uint32_t dimension = 0; dimension < 20; ++dimension) {
    const PixelSamples samples(SamplerKind::stratified, 7, 3, static_cast<int>(dimension));
    for (const std::uint32_t block : {0U, 1U, 9U}) {
      std::set<int> lines;
      std::set<int> squares;
      for (std::uint32_t i = 16 * block; i < 16 * block + 16; ++i) {
        lines.insert(static_cast<int>(16.0 * samples.one(i, dimension)));
        const Eigen::Vector2d p = samples.two(i, dimension);
        squares.insert(4 * static_cast<int>(4.0 * p.y()) + static_cast<int>(4.0 * p.x()));
      }
      EXPECT_EQ(lines.size(), 16U);
      EXPECT_EQ(squares.size(), 16U);
    }
  }
}

TEST(Sampler, HaltonPairsAreOneInEachBoxOfTheirPrimes) {
  // Any run of b1^i b2^j samples that begins at a multiple of it has one in each box of
  // b1^-i by b2^-j [Halton60]; scrambling keeps that.
  struct Case {
    std::uint32_t dimension;
    std::uint32_t first_prime;
    std::uint32_t second_prime;
  };
  for (const Case& c : {Case{0, 2, 3}, Case{1, 5, 7}, Case{4, 23, 29}}) {
    const PixelSamples samples(SamplerKind::halton, 7, 3, 2);
    for (const auto& [i, j] : {std::pair{1, 0}, {0, 1}, {1, 1}, {2, 1}}) {
      const auto across = static_cast<std::uint32_t>(std::lround(std::pow(c.first_prime, i)));
      const auto down = static_cast<std::uint32_t>(std::lround(std::pow(c.second_prime, j)));
      for (const std::uint32_t block : {0U, 3U}) {
        std::set<std::uint32_t> boxes;
        for (std::uint32_t n = 0; n < across * down; ++n) {
          const Eigen::Vector2d p = samples.two(block * across * down + n, c.dimension);
          boxes.insert(static_cast<std::uint32_t>(p.y() * down) * across +
                       static_cast<std::uint32_t>(p.x() * across));
        }
        EXPECT_EQ(boxes.size(), across * down) << c.first_prime << ' ' << i << ' ' << j;
      }
    }
  }
}

TEST(Sampler, ScrambledDigitsOfTwoPointsAreAnyTwoOthers) {
  // In base 5 the points 0 and 1 differ in their first digit: 20 ordered pairs, each as often.
  constexpr int kSeeds = 20'000;
  std::map<std::pair<int, int>, int> count;
  for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
    ++count[{static_cast<int>(5.0 * scrambled_radical_inverse(5, 0, seed)),
             static_cast<int>(5.0 * scrambled_radical_inverse(5, 1, seed))}];
  }
  ASSERT_EQ(count.size(), 20U);
  double chi2 = 0.0;
  for (const auto& [pair, n] : count) {
    chi2 += (n - kSeeds / 20.0) * (n - kSeeds / 20.0) / (kSeeds / 20.0);
  }
  EXPECT_LT(chi2, 43.8) << "19 degrees of freedom, 0.1 %";
}

TEST(Sampler, IndependentPairsAreNone) {
  const PixelSamples samples(SamplerKind::independent, 7, 3, 4);
  std::vector<Eigen::Vector2d> points;
  for (std::uint32_t i = 0; i < 256; ++i) {
    points.push_back(samples.two(i, 0));
  }
  EXPECT_FALSE(is_net(points, 8));
}

TEST(Sampler, NumbersAreEvenAndDimensionsDoNotDependOnEachOther) {
  for (const SamplerKind kind : {SamplerKind::independent, SamplerKind::stratified,
                                 SamplerKind::halton, SamplerKind::sobol}) {
    constexpr int kPixels = 4096;
    constexpr std::uint32_t kSamples = 16;
    double sum = 0.0;
    double products = 0.0;
    double of_pair = 0.0;
    for (int pixel = 0; pixel < kPixels; ++pixel) {
      const PixelSamples samples(kind, 11, pixel, 5);
      for (std::uint32_t i = 0; i < kSamples; ++i) {
        const double a = samples.one(i, 2) - 0.5;
        const double b = samples.one(i, 3) - 0.5;
        const Eigen::Vector2d c = samples.two(i, 4);
        EXPECT_TRUE(a >= -0.5 && a < 0.5 && c.minCoeff() >= 0.0 && c.maxCoeff() < 1.0);
        sum += a;
        products += a * b;
        of_pair += (c.x() - 0.5) * a;
      }
    }
    // Means of independent numbers: five standard deviations, 1/12 and 1/144 the variances.
    constexpr double kN = kPixels * static_cast<double>(kSamples);
    EXPECT_LT(std::abs(sum / kN), 5.0 / std::sqrt(12.0 * kN)) << to_string(kind);
    EXPECT_LT(std::abs(products / kN), 5.0 / std::sqrt(144.0 * kN)) << to_string(kind);
    EXPECT_LT(std::abs(of_pair / kN), 5.0 / std::sqrt(144.0 * kN)) << to_string(kind);
  }
}

TEST(Sampler, ManyPixelsAtOnceAnswerAsOne) {
  for (const SamplerKind kind : {SamplerKind::independent, SamplerKind::stratified,
                                 SamplerKind::halton, SamplerKind::sobol}) {
    for (const int n : {0, 1, 7, 100, 600}) {
      std::vector<PixelSamples> pixels;
      for (int x = 0; x < n; ++x) {
        pixels.emplace_back(kind, 11, x, 5);
      }
      std::vector<Eigen::Vector2d> squares(pixels.size());
      PixelSamples::two(pixels, 0xfffffff0U, 9, squares);
      for (std::size_t i = 0; i < pixels.size(); ++i) {
        EXPECT_EQ(squares[i], pixels[i].two(0xfffffff0U, 9)) << to_string(kind) << ' ' << i;
      }
    }
  }
}

TEST(Warp, TurnsAreCosineAndSine) {
  double worst = 0.0;
  for (int i = -100'000; i <= 100'000; ++i) {
    const double turns = i / 100'000.0;
    const Eigen::Vector2d at = at_turns(turns);
    const long double angle = 2.0L * std::numbers::pi_v<long double> * turns;
    worst = std::max({worst, std::abs(at.x() - static_cast<double>(std::cos(angle))),
                      std::abs(at.y() - static_cast<double>(std::sin(angle)))});
  }
  EXPECT_LT(worst, 4e-16);
}

TEST(Sampler, AnswersAgainWhatItAnsweredAndOtherwiseForAnotherKey) {
  const PixelSamples samples(SamplerKind::sobol, 1, 2, 3);
  EXPECT_EQ(samples.two(9, 4), PixelSamples(SamplerKind::sobol, 1, 2, 3).two(9, 4));
  EXPECT_NE(samples.two(9, 4), samples.two(9, 5));
  EXPECT_NE(samples.two(9, 4), samples.two(10, 4));
  EXPECT_NE(samples.two(9, 4), PixelSamples(SamplerKind::sobol, 1, 3, 2).two(9, 4));
  EXPECT_NE(samples.two(9, 4), PixelSamples(SamplerKind::sobol, 2, 2, 3).two(9, 4));
}

}  // namespace
}  // namespace haarlight::render
