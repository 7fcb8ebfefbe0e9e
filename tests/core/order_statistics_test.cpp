// SPDX-License-Identifier: Apache-2.0
#include "core/order_statistics.h"

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight {
namespace {

TEST(OrderStatistics, OfAFewKnownValues) {
  EXPECT_EQ(upper_median(std::vector<int>{7}), 7);
  EXPECT_EQ(upper_median(std::vector<int>{9, 1, 5}), 5);
  EXPECT_EQ(upper_median(std::vector<int>{9, 1, 5, 4}), 5);
  EXPECT_EQ(median(std::vector<double>{9, 1, 5, 4}), 4.5);
  EXPECT_EQ(median(std::vector<double>{-2.0, 8.0}), 3.0);
  std::vector<float> values{5.0F, 3.0F, 1.0F, 4.0F, 2.0F};
  EXPECT_EQ(quantile(std::span(values), 0.0), 1.0F);
  EXPECT_EQ(quantile(std::span(values), 0.49), 2.0F) << "rank floor(0.49 * 4) = 1";
  EXPECT_EQ(quantile(std::span(values), 0.5), 3.0F);
  EXPECT_EQ(quantile(std::span(values), 1.0), 5.0F);
}

TEST(OrderStatistics, AreThoseOfTheSortedValues) {
  for (std::size_t n = 1; n < 40; ++n) {
    std::vector<double> values(n);
    for (std::size_t i = 0; i < n; ++i) {
      values[i] = static_cast<double>(
          static_cast<int>(uniform_unit(hash_key(11, n, i)) * 20.0));  // with ties
    }
    std::vector<double> sorted = values;
    std::sort(sorted.begin(), sorted.end());
    EXPECT_EQ(upper_median(values), sorted[n / 2]);
    EXPECT_EQ(median(values), 0.5 * (sorted[(n - 1) / 2] + sorted[n / 2]));
    for (std::size_t rank = 0; rank < n; ++rank) {
      EXPECT_EQ(value_of_rank(std::span(values), rank), sorted[rank]);
    }
  }
}

TEST(OrderStatistics, OfNothingAreRefused) {
  EXPECT_THROW((void)upper_median(std::vector<double>()), ContractViolation);
  EXPECT_THROW((void)median(std::vector<double>()), ContractViolation);
  EXPECT_THROW((void)quantile(std::vector<double>(), 0.5), ContractViolation);
  EXPECT_THROW((void)quantile(std::vector<double>{1.0}, 1.5), ContractViolation);
  std::vector<double> one{1.0};
  EXPECT_THROW((void)value_of_rank(std::span(one), 1), ContractViolation);
}

}  // namespace
}  // namespace haarlight
