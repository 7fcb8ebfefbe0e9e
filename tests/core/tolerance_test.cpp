// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/tolerance.h"

#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

namespace haarlight {
namespace {

TEST(Compare, MeasuresAKnownDifference) {
  const std::vector<float> reference{3.0F, 0.0F, 4.0F, 0.0F};
  const std::vector<float> result{3.0F, 0.5F, 4.0F, 0.0F};
  const Achieved achieved = compare(result, reference);
  EXPECT_DOUBLE_EQ(achieved.relative_l2, 0.1);    // 0.5 / 5
  EXPECT_DOUBLE_EQ(achieved.worst_pixel, 0.125);  // 0.5 / 4
}

TEST(Compare, CallsEqualPicturesExact) {
  const std::vector<float> zero(5, 0.0F);
  const Achieved achieved = compare(zero, zero);
  EXPECT_EQ(achieved.relative_l2, 0.0);
  EXPECT_TRUE(std::isinf(achieved.psnr_db));
}

TEST(Compare, CallsAnythingAgainstBlackInfinitelyWrong) {
  const std::vector<float> zero(5, 0.0F);
  const std::vector<float> one(5, 1.0F);
  EXPECT_TRUE(std::isinf(compare(one, zero).relative_l2));
}

TEST(Compare, RefusesDifferentSizes) {
  const std::vector<float> a(5, 0.0F);
  const std::vector<float> b(4, 1.0F);
  EXPECT_THROW((void)compare(a, b), ContractViolation);
}

}  // namespace
}  // namespace haarlight
