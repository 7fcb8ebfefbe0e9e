// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/import/white_reference.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"

namespace haarlight::session {
namespace {

using ::testing::HasSubstr;

const std::vector<double> kLamp = {0.8, 0.4, 0.2};
constexpr double kReflectance = 0.5;

/// Lights around, 20 to 70 degrees up, with powers of their own.
std::vector<SessionLight> lights_around(int n) {
  std::vector<SessionLight> lights;
  for (int k = 0; k < n; ++k) {
    const double up = 0.35 + 0.87 * k / n;
    SessionLight light;
    light.coordinates = {std::cos(up) * std::cos(2.4 * k), std::cos(up) * std::sin(2.4 * k),
                         std::sin(up)};
    light.relative_power = 1.0 + 0.1 * k;
    lights.push_back(light);
  }
  return lights;
}

/// A card of that reflectance under lamps of one colour.
std::vector<PatchSample> card_under(const std::vector<SessionLight>& lights) {
  std::vector<PatchSample> patches;
  for (const SessionLight& light : lights) {
    PatchSample patch;
    for (const double lamp : kLamp) {
      patch.mean.push_back(kReflectance * lamp * light.relative_power * light.coordinates.z());
    }
    patches.push_back(patch);
  }
  return patches;
}

std::string refusal(const std::vector<PatchSample>& patches,
                    const std::vector<SessionLight>& lights, const WhiteTask& task = {}) {
  try {
    (void)find_white_reference(patches, lights, task);
  } catch (const Error& error) {
    EXPECT_FALSE(error.hint().empty());
    return error.what();
  }
  return "accepted";
}

TEST(WhiteReference, GainsOfAWarmLampAreItsInverse) {
  const std::vector<SessionLight> lights = lights_around(9);
  const WhiteReference white = find_white_reference(card_under(lights), lights, {});
  ASSERT_EQ(white.gains.size(), 3U);
  for (std::size_t c = 0; c < 3; ++c) {
    EXPECT_NEAR(white.gains[c], kLamp[0] / kLamp[c], 1e-14);  // red, the brightest, keeps
    EXPECT_NEAR(white.scatter[c], 0.0, 1e-14);
  }
  EXPECT_EQ(white.n_used, 9);
  EXPECT_FALSE(white.reflectance_scatter.has_value());
}

TEST(WhiteReference, AReflectanceMakesAWhiteThatFacesTheLightOne) {
  const std::vector<SessionLight> lights = lights_around(9);
  const WhiteReference white = find_white_reference(
      card_under(lights), lights, {.reflectance = kReflectance, .where = "card"});
  for (std::size_t c = 0; c < 3; ++c) {
    EXPECT_NEAR(white.gains[c], 1.0 / kLamp[c], 1e-13);
  }
  ASSERT_TRUE(white.reflectance_scatter.has_value());
  EXPECT_NEAR(*white.reflectance_scatter, 0.0, 1e-13);
  std::vector<SessionLight> grazing = lights;
  for (SessionLight& light : grazing) {
    light.coordinates = {std::sqrt(1.0 - 0.04 * 0.04), 0.0, 0.04};
  }
  EXPECT_THAT(refusal(card_under(lights), grazing, {.reflectance = 0.5, .where = "card"}),
              HasSubstr("3 degrees"));
}

TEST(WhiteReference, OneStrangeLampChangesNothingAndIsNamed) {
  const std::vector<SessionLight> lights = lights_around(9);
  std::vector<PatchSample> patches = card_under(lights);
  patches[4].mean[2] *= 0.5;  // twice the gain
  const WhiteReference white = find_white_reference(patches, lights, {});
  EXPECT_NEAR(white.gains[2], kLamp[0] / kLamp[2], 1e-14);
  EXPECT_EQ(white.furthest, 4);
  EXPECT_NEAR(white.distance, 1.0, 1e-12);
}

/// 1.4826 x the median of |0, 1, 2 %| twice and 0: of five values 0.98 .. 1.02, 1 %.
TEST(WhiteReference, ScatterIsTheMedianDistance) {
  const std::vector<SessionLight> lights = lights_around(5);
  std::vector<PatchSample> patches = card_under(lights);
  const double factors[] = {1.02, 0.98, 1.0, 0.99, 1.01};
  for (std::size_t k = 0; k < 5; ++k) {
    patches[k].mean[0] /= factors[k];
  }
  EXPECT_NEAR(find_white_reference(patches, lights, {}).scatter[0], 0.014826, 1e-12);
}

TEST(WhiteReference, ClippedAndDarkPatchesAreLeftOut) {
  const std::vector<SessionLight> lights = lights_around(9);
  std::vector<PatchSample> patches = card_under(lights);
  patches[0] = {{1.0, 1.0, 1.0}, true};
  patches[1] = {{0.9, 0.9, 0.9}, true};
  patches[2].mean = {0.3, 0.2, 0.019};  // its blue is too dark to tell
  const WhiteReference white = find_white_reference(patches, lights, {});
  EXPECT_EQ(white.n_used, 6);
  EXPECT_EQ(white.n_clipped, 2);
  EXPECT_EQ(white.n_dark, 1);
  EXPECT_NEAR(white.gains[2], kLamp[0] / kLamp[2], 1e-14);
  EXPECT_THAT(words(white, 9),
              ::testing::AllOf(HasSubstr("R 1.0000, G 2.0000, B 4.0000"), HasSubstr("6 of 9"),
                               HasSubstr("2 clipped, 1 dark")));
}

TEST(WhiteReference, WithoutAUsableLightItIsRefused) {
  const std::vector<SessionLight> lights = lights_around(4);
  EXPECT_THAT(refusal(std::vector<PatchSample>(4, {{1.0, 1.0, 1.0}, true}), lights),
              HasSubstr("clipped under 4"));
  for (const bool are_integers : {true, false}) {  // black, or below black once dark is off
    for (const double value : {0.0, -0.3}) {
      EXPECT_THAT(refusal(std::vector<PatchSample>(4, {{value, value, value}, false}), lights,
                          {.are_integers = are_integers}),
                  HasSubstr("dark under 4"));
    }
  }
  EXPECT_THAT(refusal(std::vector<PatchSample>(4, {{0.3}, false}), lights), HasSubstr("grey"));
}

/// Floating-point values have no range: they are compared with the brightest patch.
TEST(WhiteReference, FloatingValuesMayHaveAnyScale) {
  const std::vector<SessionLight> lights = lights_around(9);
  for (const double scale : {1e-5, 1.0, 1e5}) {
    std::vector<PatchSample> patches = card_under(lights);
    for (PatchSample& patch : patches) {
      for (double& mean : patch.mean) {
        mean *= scale;
      }
    }
    const WhiteReference white = find_white_reference(patches, lights, {.are_integers = false});
    EXPECT_EQ(white.n_used, 9);
    EXPECT_NEAR(white.gains[2], kLamp[0] / kLamp[2], 1e-13);
  }
}

TEST(WhiteReference, APatchIsItsMeanAndWhetherAnyOfItIsClipped) {
  Image<float> patch(2, 2, 3);
  for (std::size_t i = 0; i < 12; ++i) {
    patch.pixels()[i] = 0.05F * static_cast<float>(i);
  }
  const PatchSample sample = sample_patch(patch, 1.0);
  EXPECT_NEAR(sample.mean[0], 0.05 * 4.5, 1e-7);
  EXPECT_NEAR(sample.mean[2], 0.05 * 6.5, 1e-7);
  EXPECT_FALSE(sample.is_clipped);
  patch(1, 1, 0) = 1.0F;
  EXPECT_TRUE(sample_patch(patch, 1.0).is_clipped);
}

}  // namespace
}  // namespace haarlight::session
