// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shadow/visibility.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight::relight {
namespace {

TEST(VisibilityCount, TellsNoiseFromWhatIsTooBright) {
  VisibilityCount count;
  for (const double v : {0.25, 1.25, -0.05, 1.01}) {
    count.add_value(v);
  }
  EXPECT_EQ(count.n_values, 4U);
  EXPECT_EQ(count.n_excess, 1U);
  EXPECT_DOUBLE_EQ(count.worst_excess, 0.25);
}

TEST(PlateFalloff, IsCosToTheFourthOverRSquared) {
  render::SquareLight light;
  light.centre = {0.0, 0.0, 900.0};
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  const double on_axis = plate_falloff(light, {0.0, 0.0, 0.0}, up);
  EXPECT_DOUBLE_EQ(on_axis, 1.0 / (900.0 * 900.0));
  const double c = std::cos(std::atan(300.0 / 900.0));
  EXPECT_NEAR(plate_falloff(light, {300.0, 0.0, 0.0}, up) / on_axis, c * c * c * c, 1e-12);
  EXPECT_EQ(plate_falloff(light, {0.0, 0.0, 901.0}, up), 0.0);
}

TEST(FitPlateScale, FindsTheScaleDespiteShadowsAndNoise) {
  std::vector<float> values;
  std::vector<double> falloffs;
  for (std::uint64_t i = 0; i < 1000; ++i) {
    const double f = 0.5 + uniform_unit(hash_key(i, 1));
    const double shade = i % 10 < 3 ? uniform_unit(hash_key(i, 2)) : 1.0;
    const double noise = 1.0 + 0.01 * standard_normal(hash_key(i, 3));
    values.push_back(static_cast<float>(3.7 * f * shade * noise));
    falloffs.push_back(f);
  }
  EXPECT_NEAR(fit_plate_scale(values, falloffs), 3.7, 0.05);
  EXPECT_EQ(fit_plate_scale({}, {}), 0.0);
}

TEST(ShowsPlane, TellsShadowFromObject) {
  std::vector<float> plate(64);
  std::vector<float> shadowed(64);
  std::vector<float> object(64);
  for (std::size_t k = 0; k < 64; ++k) {
    plate[k] = 1.0F + 0.01F * static_cast<float>(k);
    shadowed[k] = k < 40 ? 0.0F : plate[k];
    object[k] = plate[k] * (0.5F + 0.02F * static_cast<float>(k));
  }
  EXPECT_TRUE(shows_plane(plate, plate));
  EXPECT_TRUE(shows_plane(shadowed, plate));
  EXPECT_FALSE(shows_plane(object, plate));
  EXPECT_FALSE(shows_plane(std::vector<float>(64, 0.0F), plate));
  EXPECT_FALSE(shows_plane(plate, std::vector<float>(64, 0.0F)));
}

TEST(HeightFromFalloff, FindsTheSurfaceWhateverItsAlbedo) {
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d step(0.0, -0.8, 1.0);  // towards a camera, per mm of height
  std::vector<render::SquareLight> lights(256);
  std::vector<float> plate(lights.size());
  std::vector<double> slopes(lights.size());
  for (std::size_t k = 0; k < lights.size(); ++k) {
    const auto i = static_cast<double>(k);
    lights[k].centre = {60.0 * (std::fmod(i, 16.0) - 7.5), 60.0 * (std::floor(i / 16.0) - 7.5),
                        900.0};
    lights[k].lobe_mu = 1.2;
    plate[k] = static_cast<float>(1e6 * plate_falloff(lights[k], {0.0, 0.0, 0.0}, up));
    slopes[k] = falloff_slope(lights[k], {0.0, 0.0, 0.0}, up, step);
    const double differences = 0.5 *
                               std::log(plate_falloff(lights[k], 1e-3 * step, up) /
                                        plate_falloff(lights[k], -1e-3 * step, up)) /
                               1e-3;
    EXPECT_NEAR(slopes[k], differences, 1e-9);
  }
  for (const double height : {-30.0, 0.0, 30.0, 90.0}) {
    std::vector<float> values(lights.size());
    for (std::size_t k = 0; k < lights.size(); ++k) {
      const double noise = 1.0 + 0.01 * standard_normal(hash_key(k, 7));
      // Of the albedo that makes it as bright under the middle light.
      const double albedo = std::pow((900.0 - height) / 900.0, 2);
      values[k] = static_cast<float>(1e6 * albedo *
                                     plate_falloff(lights[k], height * step, up) * noise);
    }
    const SurfaceHeight found = height_from_falloff(values, plate, slopes, 0.05);
    // First order, and only of the lights within 5 %: the tops that matter are told, not measured.
    EXPECT_NEAR(found.mm, height, 3.0 * found.error_mm + 0.2 * std::abs(height)) << height;
    EXPECT_LT(found.error_mm, 4.0) << height;
    if (height == 0.0) {
      EXPECT_GT(found.error_mm, 0.2);
    }
  }
  const std::vector<float> dark(plate.size(), 0.0F);
  EXPECT_TRUE(std::isinf(height_from_falloff(dark, plate, slopes, 0.05).error_mm));
  EXPECT_TRUE(std::isinf(
      height_from_falloff(plate, plate, std::vector<double>(plate.size(), 1e-3), 0.05)
          .error_mm));
}

TEST(SettleLit, NoiseDoesNotDarkenWhatIsLitAndShadowsStay) {
  constexpr double kNoise = 0.01;
  Image<float> value(60, 60, 1);
  Image<std::uint8_t> usable(60, 60, 1);
  for (int y = 0; y < 60; ++y) {
    for (int x = 0; x < 60; ++x) {
      const std::uint64_t key =
          hash_key(static_cast<std::uint64_t>(y), static_cast<std::uint64_t>(x));
      // A shadow with a penumbra of 5 pixels to the right of column 40; column 0 is not usable.
      const double seen = std::clamp((45.0 - x) / 5.0, 0.0, 1.0);
      value(y, x) = static_cast<float>(seen * (1.0 + kNoise * standard_normal(key)));
      usable(y, x) = x > 0 ? 1 : 0;
    }
  }
  const Image<float> noisy = value;
  // 2300 values: the median distance's own standard error is 1.2/sqrt(2300) = 2.5 %.
  EXPECT_NEAR(settle_lit(value, usable.view(), 0.05), kNoise, 0.1 * kNoise);
  int n_noisy = 0;
  for (int y = 0; y < 60; ++y) {
    for (int x = 0; x < 60; ++x) {
      if (x == 0 || x > 41) {
        EXPECT_EQ(value(y, x), noisy(y, x));
      } else if (x < 40) {
        n_noisy += value(y, x) != 1.0F ? 1 : 0;
      }
    }
  }
  EXPECT_LT(n_noisy, 20);  // 0.13 % of 2340 means lie three standard errors below
  Image<float> black(3, 3, 1);
  EXPECT_EQ(settle_lit(black, Image<std::uint8_t>(3, 3, 1).view(), 0.05), 0.0);
}

TEST(GrowHidden, GrowsByOnePixel) {
  Image<std::uint8_t> mask(5, 5, 1);
  for (std::uint8_t& m : mask.pixels()) {
    m = 1;
  }
  mask(2, 2) = 0;
  const Image<std::uint8_t> grown = grow_hidden(mask.view());
  EXPECT_EQ(grown(1, 1), 0);
  EXPECT_EQ(grown(3, 2), 0);
  EXPECT_EQ(grown(0, 2), 1);
}

}  // namespace
}  // namespace haarlight::relight
