// SPDX-License-Identifier: Apache-2.0
#include "core/random.h"

#include <cmath>

#include <gtest/gtest.h>

namespace haarlight {
namespace {

struct Moments {
  double mean = 0.0;
  double variance = 0.0;
};

template <class Draw>
Moments moments(int n, const Draw& draw) {
  double sum = 0.0;
  double squares = 0.0;
  for (int i = 0; i < n; ++i) {
    const double x = draw(hash_key(42, static_cast<std::uint64_t>(i)));
    sum += x;
    squares += x * x;
  }
  const double mean = sum / n;
  return {mean, squares / n - mean * mean};
}

constexpr int kDraws = 200'000;

TEST(HashKey, DependsOnEveryKeyAndOnTheirOrder) {
  EXPECT_NE(hash_key(1, 2), hash_key(2, 1));
  EXPECT_NE(hash_key(1, 0), hash_key(1, 1));
  EXPECT_NE(hash_key(0, 0, 0, 1), hash_key(0, 0, 1, 0));
}

TEST(StandardNormal, HasMeanZeroAndVarianceOne) {
  const Moments m = moments(kDraws, standard_normal);
  EXPECT_NEAR(m.mean, 0.0, 5.0 / std::sqrt(kDraws));            // five sigma
  EXPECT_NEAR(m.variance, 1.0, 5.0 * std::sqrt(2.0 / kDraws));  // five sigma
}

TEST(Poisson, HasEqualMeanAndVarianceBelowAndAboveTheSwitch) {
  for (const double mean : {0.3, 4.0, 29.9, 30.1, 400.0, 12000.0}) {
    const Moments m = moments(kDraws, [&](std::uint64_t h) { return poisson(mean, h); });
    EXPECT_NEAR(m.mean, mean, 5.0 * std::sqrt(mean / kDraws)) << mean;
    // variance of the sample variance of a Poisson: (mean + 2 mean^2)/n; 1/12 from rounding and
    // 0.3 % as the header states
    EXPECT_NEAR(
        m.variance, mean,
        5.0 * std::sqrt((mean + 2.0 * mean * mean) / kDraws) + 1.0 / 12.0 + 0.003 * mean)
        << mean;
  }
  EXPECT_EQ(poisson(0.0, 1), 0U);
  EXPECT_EQ(poisson(-1.0, 1), 0U);
}

}  // namespace
}  // namespace haarlight
