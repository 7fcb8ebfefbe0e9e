// SPDX-License-Identifier: Apache-2.0
#include "capture/proof/light_predictor.h"

#include <array>
#include <cmath>

#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight::capture {
namespace {

constexpr std::array<FaceGrid, 1> kFace{FaceGrid{6, 6}};

/// A smooth picture of light k, and noise of a thousandth.
PointValues picture(int k) {
  PointValues out;
  for (int i = 0; i < kProofPoints; ++i) {
    const double u = k % 6 - 2.5;
    const int row = k / 6;
    const double v = row - 2.5;
    const double x = i % 8 - 3.5;
    const int down = i / 8;
    const double y = down - 3.5;
    const double noise =
        standard_normal(hash_key(static_cast<std::uint64_t>(k), static_cast<std::uint64_t>(i)));
    out[i] = 10.0 / (1.0 + 0.02 * (u - x) * (u - x) + 0.03 * (v - y) * (v - y)) + 0.01 * noise;
  }
  return out;
}

PointValues noise() { return PointValues::Constant(1e-4); }

std::vector<DrivenLight> light(int k) { return {{k, 1.0}}; }

TEST(LightPredictor, NeighboursPredictALightThatWasNotSeen) {
  LightPredictor predictor(kFace);
  for (int k = 0; k < 36; ++k) {
    if (k != 14) {
      predictor.learn(light(k), picture(k), noise());
    }
  }
  const auto own = predictor.predict(light(14));
  const double miss = (own.mean - picture(14)).abs().maxCoeff();
  const double to_neighbour = (picture(15) - picture(14)).abs().maxCoeff();
  EXPECT_LT(miss, 0.3 * to_neighbour);
  EXPECT_GT(own.spread, predictor.spread_of(15)) << "it knows that it was not seen";
}

TEST(LightPredictor, ASumOfLightsIsTheSumOfTheirPictures) {
  LightPredictor predictor(kFace);
  for (int k = 0; k < 36; ++k) {
    predictor.learn(light(k), picture(k), noise());
  }
  const std::vector<DrivenLight> sum{{3, 1.0}, {20, 0.5}, {31, 1.0}};
  const PointValues expected = picture(3) + 0.5 * picture(20) + picture(31);
  // Every picture was learned with a noise of 0.01, three of them are summed.
  EXPECT_LT((predictor.predict(sum).mean - expected).abs().maxCoeff(), 0.1);
}

}  // namespace
}  // namespace haarlight::capture
