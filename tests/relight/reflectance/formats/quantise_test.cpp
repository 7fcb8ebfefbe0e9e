// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/reflectance/formats/quantise.h"

#include <cmath>
#include <numeric>

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "haarlight/core/error.h"
#include "tests/relight/reflectance/formats/quantise_model.h"
#include "tests/relight/reflectance/formats/reflectance_truth.h"

namespace haarlight::relight {
namespace {

using testing::empty_model;
using testing::smooth_coefficients;

/// Coefficients of one pixel per column, in hundredths.
Image<float> drawn_coefficients(int n_planes) {
  const int n = *rc::gen::inRange(1, 6);
  Image<float> coefficients(1, n, n_planes);
  for (float& value : coefficients.pixels()) {
    value = static_cast<float>(*rc::gen::inRange(-30'000, 30'000)) / 100.0F;
  }
  return coefficients;
}

RC_GTEST_PROP(Quantise, NoValueMovesByMoreThanHalfAStep, ()) {
  const auto rule = *rc::gen::element(ScaleRule::any, ScaleRule::rti, ScaleRule::ptm);
  const bool is_hsh = rule == ScaleRule::rti;
  ReflectanceModel model = empty_model(is_hsh ? ReflectanceBasis::hsh : ReflectanceBasis::ptm,
                                       ReflectanceColour::rgb, is_hsh ? 4 : 6);
  const Image<float> coefficients = drawn_coefficients(3 * model.n_terms);
  const QuantisationLoss loss = quantise(model, coefficients.view(), rule);
  // Above 0.5 by what rounding the scale to float or six decimals moves the ends.
  RC_ASSERT(loss.worst_steps() <= 0.5 + 1e-4);
  RC_ASSERT(obeys(rule, model));
  RC_ASSERT(obeys(ScaleRule::any, model));
}

RC_GTEST_PROP(Quantise, EveryBiasOfAPtmIsAByte, ()) {
  ReflectanceModel model = empty_model(ReflectanceBasis::ptm, ReflectanceColour::rgb, 6);
  quantise(model, drawn_coefficients(18).view(), ScaleRule::ptm);
  for (const PlaneScale& scale : model.scales) {
    const PtmScale ptm = ptm_scale(scale);
    RC_ASSERT(ptm.bias >= 0);
    RC_ASSERT(ptm.bias <= 255);
    RC_ASSERT(ptm.scale > 0.0);
    // Printed with six decimals it is the same number.
    RC_ASSERT(std::stod(std::to_string(ptm.scale)) == ptm.scale);
  }
}

RC_GTEST_PROP(Quantise, ScalesThatAFileCanSayAreLeftAlone, ()) {
  const auto rule = *rc::gen::element(ScaleRule::any, ScaleRule::ptm);
  ReflectanceModel model = empty_model(ReflectanceBasis::ptm, ReflectanceColour::rgb, 6);
  quantise(model, drawn_coefficients(18).view(), rule);
  const ReflectanceModel same = with_scales_of(rule, model);
  RC_ASSERT(same.scales == model.scales);
  RC_ASSERT(std::equal(same.planes.pixels().begin(), same.planes.pixels().end(),
                       model.planes.pixels().begin()));
}

TEST(Quantise, RowsOneByOneAreThePictureAtOnce) {
  const Image<float> coefficients = smooth_coefficients(7, 5, 18);
  ReflectanceModel model = empty_model(ReflectanceBasis::ptm, ReflectanceColour::rgb, 6);
  const QuantisationLoss at_once = quantise(model, coefficients.view(), ScaleRule::ptm);
  PlaneRanges ranges(18);
  for (int y = 0; y < 7; ++y) {
    PlaneRanges row(18);
    row.add(coefficients.view().row(y));
    ranges.merge(row);
  }
  EXPECT_EQ(choose_scales(ranges, ReflectanceColour::rgb, 6, ScaleRule::ptm), model.scales);
  QuantisationLoss loss(18);
  for (int y = 0; y < 7; ++y) {
    QuantisationLoss row(18);
    row.add(coefficients.view().row(y), model.scales, model.planes.view().row(y));
    loss.merge(row);
  }
  for (int p = 0; p < 18; ++p) {
    EXPECT_NEAR(loss.rms(p), at_once.rms(p), 1e-15);
  }
}

/// Steps of 1/255 have an error of 1/sqrt(12) steps where values are spread evenly.
TEST(Quantise, MeasuredLossIsThatOfUniformRounding) {
  constexpr int kN = 20'001;
  Image<float> ramp(1, kN, 9);
  for (int x = 0; x < kN; ++x) {
    for (int p = 0; p < 9; ++p) {
      ramp(0, x, p) = static_cast<float>(x) / static_cast<float>(kN - 1);
    }
  }
  ReflectanceModel model = empty_model(ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6);
  const QuantisationLoss loss = quantise(model, ramp.view());
  EXPECT_NEAR(loss.rms(0), 1.0 / 255.0 / std::sqrt(12.0), 2e-5);
}

TEST(Quantise, BrightColoursOfLrgbGiveTheirExcessToTheLuminance) {
  Image<float> coefficients = smooth_coefficients(6, 6, 9);
  for (int y = 0; y < 6; ++y) {
    for (int x = 0; x < 6; ++x) {
      for (int c = 6; c < 9; ++c) {
        coefficients(y, x, c) *= 5.0F;  // up to 2.2
      }
    }
  }
  ReflectanceModel model = empty_model(ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6);
  quantise(model, coefficients.view());
  const ReflectanceModel moved = with_scales_of(ScaleRule::ptm, model);
  EXPECT_TRUE(obeys(ScaleRule::ptm, moved));
  for (const Eigen::Vector3d& direction : testing::spread_directions(5)) {
    EXPECT_GT(testing::psnr_db(relit(moved, direction).view(), relit(model, direction).view()),
              45.0);
  }
}

TEST(Quantise, BrokenCoefficientsAreNamed) {
  Image<float> coefficients = smooth_coefficients(2, 2, 9);
  coefficients(1, 0, 4) = std::nanf("");
  ReflectanceModel model = empty_model(ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6);
  try {
    quantise(model, coefficients.view());
    FAIL() << "NaN was taken";
  } catch (const Error& error) {
    EXPECT_EQ(error.where(), "plane 4");
  }
}

}  // namespace
}  // namespace haarlight::relight
