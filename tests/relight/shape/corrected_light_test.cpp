// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/corrected_light.h"

#include <cmath>
#include <cstdio>
#include <numbers>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/relight/shape/normal_picture.h"
#include "tests/relight/shape/made_lights.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

struct Spread {
  double mean = 0.0;
  double deviation = 0.0;
};

Spread spread_of(const Image<float>& picture) {
  Spread s;
  const auto n = static_cast<double>(picture.pixels().size());
  for (const float value : picture.pixels()) {
    s.mean += double{value} / n;
  }
  for (const float value : picture.pixels()) {
    s.deviation += std::pow(double{value} - s.mean, 2) / n;
  }
  s.deviation = std::sqrt(s.deviation);
  return s;
}

Image<float> flat_target(const NearLight& light, const PixelPoints& pixels) {
  Image<float> picture(30, 40, 3);
  for (int y = 0; y < 30; ++y) {
    for (int x = 0; x < 40; ++x) {
      for (int c = 0; c < 3; ++c) {
        picture(y, x, c) = static_cast<float>(
            0.6 * light.power[c] *
            light_stencil(light, pixels.at(x + 0.5, y + 0.5), Vector3d::UnitZ()));
      }
    }
  }
  return picture;
}

TEST(LightCorrection, AFlatTargetComesOutEvenAndAlikeUnderEveryLight) {
  const PixelPoints pixels = PixelPoints::orthographic(40, 30, 400.0);
  std::vector<NearLight> lights = testing::light_array(3, 200.0, 500.0, 1.0);
  lights[2].power = {2.0, 1.0, 0.5};
  const LightCorrection correction(lights, pixels, 40, 30, Vector3d::UnitZ(), FallOff::plane);
  double first = 0.0;
  for (int k = 0; k < 9; ++k) {
    const Image<float> picture = flat_target(lights[static_cast<std::size_t>(k)], pixels);
    const Spread before = spread_of(picture);
    const Spread after = spread_of(correction.corrected(picture.view(), k));
    if (k == 0) {
      first = after.mean;
      std::printf("flat target: std/mean %.3f before, %.1e after\n",
                  before.deviation / before.mean, after.deviation / after.mean);
    }
    EXPECT_GT(before.deviation / before.mean, 0.09);
    EXPECT_LT(after.deviation / after.mean, 1e-6);
    EXPECT_NEAR(after.mean / first, 1.0, 1e-6);
  }
}

TEST(LightCorrection, DistanceAloneLeavesTheCosine) {
  const PixelPoints pixels = PixelPoints::orthographic(40, 30, 400.0);
  std::vector<NearLight> lights(1);
  lights[0].position_mm = {0.0, 0.0, 500.0};
  lights[0].mu = 2.0;
  const LightCorrection correction(lights, pixels, 40, 30, Vector3d::UnitZ(),
                                   FallOff::distance);
  const Image<float> even = correction.corrected(flat_target(lights[0], pixels).view(), 0);
  const auto cosine = [&](int y, int x) {
    return 500.0 / (lights[0].position_mm - pixels.at(x + 0.5, y + 0.5)).norm();
  };
  EXPECT_NEAR(even(0, 0) / even(14, 20), cosine(0, 0) / cosine(14, 20), 1e-6);
  EXPECT_NEAR(even(29, 39, 2) / even(14, 20, 2), cosine(29, 39) / cosine(14, 20), 1e-6);
}

TEST(LightCorrection, AttenuationIsOneInTheMiddleAndTheClosedFormElsewhere) {
  const PixelPoints pixels = PixelPoints::orthographic(41, 31, 410.0);
  std::vector<NearLight> lights(1);
  lights[0].position_mm = {0.0, 0.0, 300.0};
  const LightCorrection correction(lights, pixels, 41, 31, Vector3d::UnitZ(), FallOff::plane);
  const Image<float> map = correction.attenuation(0);
  EXPECT_FLOAT_EQ(map(15, 20), 1.0F);
  EXPECT_NEAR(map(15, 0), std::pow(300.0 / std::hypot(300.0, 200.0), 3), 1e-6);
}

TEST(LightCorrection, LightsBehindTheTargetGiveBlackAndAloneAreRefused) {
  const PixelPoints pixels = PixelPoints::orthographic(8, 8, 100.0);
  std::vector<NearLight> lights(2);
  lights[0].position_mm = {0.0, 0.0, -300.0};
  lights[1].position_mm = {0.0, 0.0, 300.0};
  const LightCorrection correction(lights, pixels, 8, 8, Vector3d::UnitZ(), FallOff::plane);
  Image<float> picture(8, 8, 1);
  std::fill(picture.pixels().begin(), picture.pixels().end(), 1.0F);
  const Image<float> black = correction.corrected(picture.view(), 0);
  const Image<float> nothing = correction.attenuation(0);
  EXPECT_THAT(black.pixels(), ::testing::Each(0.0F));
  EXPECT_THAT(nothing.pixels(), ::testing::Each(0.0F));
  lights.resize(1);
  EXPECT_THROW(LightCorrection(lights, pixels, 8, 8, Vector3d::UnitZ(), FallOff::plane), Error);
}

TEST(NormalPicture, TurnsNormalsAndLeavesUnknownOnes) {
  Image<float> normals(1, 2, 3);
  normals(0, 0, 0) = 0.6F;
  normals(0, 0, 2) = 0.8F;
  Eigen::Matrix3d turn;  // x to y, y to z, z to x
  turn << 0, 0, 1, 1, 0, 0, 0, 1, 0;
  const Image<float> turned = turned_normals(normals.view(), turn);
  EXPECT_THAT(turned.pixels(), ::testing::ElementsAre(0.8F, 0.6F, 0.0F, 0.0F, 0.0F, 0.0F));
}

TEST(NormalPicture, CodesNormalsAndShowsGloss) {
  Image<float> normals(1, 3, 3);
  normals(0, 0, 2) = 1.0F;
  normals(0, 1, 0) = 0.6F;
  normals(0, 1, 2) = 0.8F;
  const Image<float> map = normal_map(normals.view());
  EXPECT_NEAR(srgb_from_linear(map(0, 0, 2)), 1.0, 1e-6);
  EXPECT_NEAR(srgb_from_linear(map(0, 0, 0)), 0.5, 1e-6);
  EXPECT_NEAR(srgb_from_linear(map(0, 1, 0)), 0.8, 1e-6);
  EXPECT_EQ(map(0, 2, 2), 0.0F);  // unknown
  Image<float> albedo(1, 3, 1);
  albedo(0, 0) = albedo(0, 1) = 0.3F;
  EnhancedLook look;
  look.light = {1.0, 0.0, 0.0};
  look.diffuse = 0.5;
  look.specular = 0.0;
  const Image<float> lit = enhanced_picture(normals.view(), albedo.view(), look);
  EXPECT_NEAR(lit(0, 0), 0.0, 1e-6);
  EXPECT_NEAR(lit(0, 1), 0.5 * 0.6, 1e-6);
  EXPECT_EQ(lit(0, 2), 0.0F);
  look.specular = 1.0;
  look.exponent = 1.0;
  const double half = (0.6 + 0.8) / std::numbers::sqrt2;
  EXPECT_NEAR(enhanced_picture(normals.view(), albedo.view(), look)(0, 1), 0.3 + half, 1e-6);
}

}  // namespace
}  // namespace haarlight::relight
