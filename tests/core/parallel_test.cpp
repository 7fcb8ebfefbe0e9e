// SPDX-License-Identifier: Apache-2.0
#include "core/parallel.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"

namespace haarlight {
namespace {

std::vector<double> sums_with_threads(int n_threads) {
  const ThreadLimit limit(n_threads);
  constexpr std::size_t kCount = 1003;
  constexpr std::size_t kGrain = 17;
  std::vector<double> sums((kCount + kGrain - 1) / kGrain);
  parallel_for(kCount, kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      sums[begin / kGrain] += std::sin(static_cast<double>(i));
    }
  });
  return sums;
}

TEST(ParallelFor, GivesTheSameBitsOnAnyNumberOfThreads) {
  const std::vector<double> one = sums_with_threads(1);
  EXPECT_EQ(one, sums_with_threads(2));
  EXPECT_EQ(one, sums_with_threads(7));
}

TEST(ParallelFor, PassesAnExceptionOn) {
  EXPECT_THROW(
      parallel_for(10, 1, [](std::size_t, std::size_t) { throw Error("a", "b", "c"); }), Error);
}

TEST(ParallelFor, DoesNothingForNothing) {
  parallel_for(0, 4, [](std::size_t, std::size_t) { FAIL(); });
}

}  // namespace
}  // namespace haarlight
