// SPDX-License-Identifier: Apache-2.0
#include "relight/study/light_transform.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/basis/haar.h"
#include "relight/study/dyadic_transform.h"

namespace haarlight::relight {
namespace {

std::vector<float> noise(std::size_t n, std::uint64_t seed) {
  std::vector<float> values(n);
  for (std::size_t i = 0; i < n; ++i) {
    values[i] = static_cast<float>(uniform_unit(hash_key(seed, i)) - 0.5);
  }
  return values;
}

/// Light patterns of every coefficient, one per column.
Eigen::MatrixXd patterns(const LightTransform& transform) {
  const auto n = static_cast<std::size_t>(transform.n_coefficients());
  const auto n_lights = static_cast<std::size_t>(transform.n_lights());
  Eigen::MatrixXd all(transform.n_lights(), transform.n_coefficients());
  std::vector<float> one(n);
  std::vector<float> lights(n_lights);
  for (std::size_t i = 0; i < n; ++i) {
    std::fill(one.begin(), one.end(), 0.0F);
    one[i] = 1.0F;
    transform.synthesise(one, lights);
    for (std::size_t k = 0; k < n_lights; ++k) {
      all(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(i)) = double{lights[k]};
    }
  }
  return all;
}

std::vector<std::unique_ptr<LightTransform>> complete_transforms(const ArrayGrid& grid,
                                                                 bool is_standard = true) {
  std::vector<std::unique_ptr<LightTransform>> all;
  all.push_back(make_direct_transform(grid.n_face() * grid.n_faces));
  all.push_back(make_haar_transform(grid, false));
  if (is_standard) {
    all.push_back(make_haar_transform(grid, true));
  }
  all.push_back(make_dct_transform(grid));
  all.push_back(make_cdf53_transform(grid));
  return all;
}

TEST(LightTransform, AllCoefficientsGiveTheLightsBack) {
  for (const auto& [grid, is_standard] :
       {std::pair{ArrayGrid{8, 8, 2}, true}, std::pair{ArrayGrid{32, 32, 1}, true},
        std::pair{ArrayGrid{5, 7, 3}, false}, std::pair{ArrayGrid{1, 1, 1}, true},
        std::pair{ArrayGrid{1, 6, 1}, false}}) {
    for (const auto& transform : complete_transforms(grid, is_standard)) {
      const auto n = static_cast<std::size_t>(transform->n_lights());
      EXPECT_TRUE(transform->is_complete());
      const std::vector<float> lights = noise(3 * n, 5);
      std::vector<float> coefficients(3 * n);
      std::vector<float> back(3 * n);
      transform->analyse(lights, coefficients);
      transform->synthesise(coefficients, back);
      for (std::size_t i = 0; i < back.size(); ++i) {
        // 2 log2(n) additions and a scale, each half an ulp of at most 1.
        EXPECT_NEAR(back[i], lights[i], 4e-6);
      }
    }
  }
}

TEST(LightTransform, PatternsOfOrthonormalTransformsAreOrthonormal) {
  std::vector<std::unique_ptr<LightTransform>> all = complete_transforms({8, 8, 2});
  all.push_back(make_haar_transform({4, 16, 2}, false));
  for (const auto& transform : all) {
    const Eigen::MatrixXd gram = patterns(*transform).transpose() * patterns(*transform);
    if (transform->is_orthonormal()) {
      EXPECT_LT((gram - Eigen::MatrixXd::Identity(128, 128)).cwiseAbs().maxCoeff(), 2e-6);
    } else {
      // Of CDF 5/3 only the lengths are 1.
      EXPECT_LT((gram.diagonal().array() - 1.0).abs().maxCoeff(), 2e-6);
      EXPECT_GT((gram - Eigen::MatrixXd::Identity(128, 128)).cwiseAbs().maxCoeff(), 0.1);
    }
  }
}

TEST(LightTransform, NonstandardHaarIsTheCodersHaar) {
  const auto transform = make_haar_transform({16, 16, 1}, false);
  std::vector<float> x = noise(256, 3);
  std::vector<float> coefficients(256);
  transform->analyse(x, coefficients);
  haar_forward(std::span<float>(x), HaarGrid{16, 16});
  EXPECT_EQ(coefficients, x);

  std::vector<float> wide = noise(30, 4);  // two faces
  std::vector<float> of_wide(wide.size());
  make_haar_transform({3, 5, 2}, false)->analyse(wide, of_wide);
  haar_forward(std::span<float>(wide), HaarGrid{3, 5});
  EXPECT_EQ(of_wide, wide);
}

TEST(LightTransform, StandardHaarIsTheProductOfLines) {
  // Of a product f(row) g(col) the coefficients are products of the lines' own: a ramp's line
  // of four has mean 2 m, one coarse detail, and two equal fine ones.
  const auto transform = make_haar_transform({4, 4, 1}, true);
  std::vector<float> x(16);
  for (std::size_t i = 0; i < 16; ++i) {
    x[i] = static_cast<float>(i % 4) * (i / 4 == 0 ? 1.0F : 0.0F);
  }
  std::vector<float> c(16);
  transform->analyse(x, c);
  const double r = std::numbers::sqrt2;
  const double line[] = {3.0, -2.0, -1.0 / r, -1.0 / r};  // of 0 1 2 3
  const double impulse[] = {0.5, 0.5, 1.0 / r, 0.0};      // of 1 0 0 0
  for (std::size_t y = 0; y < 4; ++y) {
    for (std::size_t k = 0; k < 4; ++k) {
      EXPECT_NEAR(c[4 * y + k], impulse[y] * line[k], 1e-6);
    }
  }
}

TEST(LightTransform, DctIsTheDirectSum) {
  const int rows = 5;
  const int cols = 6;
  const auto transform = make_dct_transform({rows, cols, 1});
  const std::vector<float> x = noise(30, 11);
  std::vector<float> c(30);
  transform->analyse(x, c);
  for (int i = 0; i < rows; ++i) {
    for (int j = 0; j < cols; ++j) {
      double sum = 0.0;
      for (int y = 0; y < rows; ++y) {
        for (int k = 0; k < cols; ++k) {
          const int at = y * cols + k;
          sum += double{x[static_cast<std::size_t>(at)]} *
                 std::cos(std::numbers::pi * (y + 0.5) * i / rows) *
                 std::cos(std::numbers::pi * (k + 0.5) * j / cols);
        }
      }
      sum *= std::sqrt((i == 0 ? 1.0 : 2.0) / rows) * std::sqrt((j == 0 ? 1.0 : 2.0) / cols);
      EXPECT_NEAR(c[static_cast<std::size_t>(i * cols + j)], sum, 1e-6);
    }
  }
}

TEST(LightTransform, DctOfAConstantIsOneCoefficient) {
  const auto transform = make_dct_transform({8, 8, 1});
  std::vector<float> c(64);
  transform->analyse(std::vector<float>(64, 0.5F), c);
  EXPECT_NEAR(c[0], 4.0, 1e-6);
  for (std::size_t i = 1; i < 64; ++i) {
    EXPECT_NEAR(c[i], 0.0, 1e-6);
  }
}

TEST(LightTransform, HaarOfNoGridIsTheCallersBug) {
  EXPECT_THROW((void)make_haar_transform({0, 7, 1}, false), ContractViolation);
  EXPECT_THROW((void)make_haar_transform({4, 1025, 1}, false), ContractViolation);
  EXPECT_THROW((void)make_haar_transform({6, 6, 1}, true), ContractViolation);
  EXPECT_THROW((void)make_dct_transform({0, 0, 0}), ContractViolation);
}

// --- lifting ---------------------------------------------------------------------------------

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
  // The low-pass -1/8 1/4 3/4 1/4 -1/8 shows in a detail of the next level: at index 18 that is
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

TEST(DyadicTransform, OrderNamesEveryIndexOnceFromCoarseToFine) {
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

}  // namespace
}  // namespace haarlight::relight
