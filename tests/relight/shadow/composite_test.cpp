// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shadow/composite.h"

#include <cmath>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"

namespace haarlight::relight {
namespace {

TEST(CompareDrawn, LooksAtTheDrawnPixelsOnly) {
  Image<float> truth(2, 2, 3);
  for (float& value : truth.pixels()) {
    value = 1.0F;
  }
  Image<float> picture = truth;
  Image<std::uint8_t> drawn(2, 2, 1);
  drawn(0, 1) = 1;
  drawn(1, 0) = 1;
  picture(0, 0, 1) = 100.0F;  // not the object's
  EXPECT_EQ(compare_drawn(picture, truth, drawn).relative_l2, 0.0);
  picture(1, 0, 2) = 1.5F;  // one of six values
  const Achieved found = compare_drawn(picture, truth, drawn);
  EXPECT_NEAR(found.relative_l2, 0.5 / std::sqrt(6.0), 1e-12);
  EXPECT_NEAR(found.worst_pixel, 0.5, 1e-12);
}

TEST(CompareDrawn, WantsPicturesOfOneSize) {
  const Image<float> picture(2, 2, 3);
  const Image<std::uint8_t> drawn(2, 3, 1);
  EXPECT_THROW((void)compare_drawn(picture, picture, drawn), ContractViolation);
}

TEST(SceneScale, IsTheRadianceOfThePlane) {
  // A grey plane of albedo 1/2 under an LED of 4 mm^2: rho A / (pi 1e6 g).
  EXPECT_NEAR(scene_scale(2.0, 1, 0.5, 4.0), 0.5 * 4.0 / (3.14159265358979 * 2e6), 1e-18);
}

}  // namespace
}  // namespace haarlight::relight
