#include "capture/light_predictor.h"

#include <array>
#include <cmath>

#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight {
namespace {

constexpr std::array<FaceGrid, 1> kFace{FaceGrid{6, 6}};

/// A smooth picture of light k, and noise of a thousandth.
PointValues picture(int k) {
  PointValues out;
  for (int i = 0; i < kProofPoints; ++i) {
    const double u = k % 6 - 2.5;
    const double v = k / 6 - 2.5;
    const double x = i % 8 - 3.5;
    const double y = i / 8 - 3.5;
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

TEST(LightPredictor, WhatWasLearnedCanBeTakenBack) {
  LightPredictor predictor(kFace);
  for (int k = 0; k < 36; ++k) {
    predictor.learn(light(k), picture(k), noise());
  }
  const auto before = predictor.predict(light(10));
  const PointValues wrong = picture(35);
  const double rho = predictor.learn(light(9), wrong, noise());
  EXPECT_GT((predictor.predict(light(9)).mean - picture(9)).abs().maxCoeff(), 0.5);
  predictor.forget(light(9), wrong, rho);
  const auto after = predictor.predict(light(10));
  // Doubles through one step and back, conditioned by v / rho <= 1e4.
  EXPECT_LT((after.mean - before.mean).abs().maxCoeff(), 1e-6);
  EXPECT_NEAR(after.spread, before.spread, 1e-8);
}

TEST(LightPredictor, WithoutAFrameIsAsIfItHadNeverBeen) {
  LightPredictor predictor(kFace);
  for (int k = 0; k < 36; ++k) {
    if (k != 21) {
      predictor.learn(light(k), picture(k), noise());
    }
  }
  const auto never = predictor.predict(light(21));
  const double rho = predictor.learn(light(21), picture(21), noise());
  const auto without = predictor.predict_without(light(21), picture(21), rho);
  EXPECT_LT((without.mean - never.mean).abs().maxCoeff(), 1e-6);
  EXPECT_NEAR(without.spread / never.spread, 1.0, 1e-6);
}

}  // namespace
}  // namespace haarlight
