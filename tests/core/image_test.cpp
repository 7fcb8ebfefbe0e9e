// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/image.h"

#include <gtest/gtest.h>

namespace haarlight {
namespace {

TEST(Image, IsZeroAndIndexedByRowColumnChannel) {
  Image<float> image(2, 3, 2);
  EXPECT_EQ(image(1, 2, 1), 0.0F);
  image(1, 2, 1) = 5.0F;
  EXPECT_EQ(image.pixels()[11], 5.0F);
  EXPECT_EQ(image.view().row(1)[5], 5.0F);
}

TEST(ImageView, WalksRowsByItsStride) {
  const std::vector<int> numbers{0, 1, 2, 3, 4, 5, 6, 7};
  const ImageView<const int> view(numbers.data(), 2, 3, 1, 4);
  EXPECT_EQ(view(1, 2), 6);
  EXPECT_EQ(view.row(1).size(), 3U);
}

TEST(Image, RefusesANegativeShape) { EXPECT_THROW(Image<float>(-1, 1, 1), ContractViolation); }

}  // namespace
}  // namespace haarlight
