// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/fit/fit_pipeline.h"

#include <cmath>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/relight/reflectance/formats/reflectance_file.h"
#include "relight/pipeline/bytes_on_disk.h"
#include "relight/pipeline/fit/fit_report.h"
#include "tests/relight/pipeline/made_capture.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using testing::PictureSize;

constexpr int kLights = 24;
constexpr PictureSize kSize{8, 6};
// An 8-bit picture none of whose values is off by more than one step has at least this PSNR.
const double kOneStepDb = 20.0 * std::log10(255.0);

/// A polynomial of the light's x and y, of the coded value: what PTM fits without error.
double coded_value(const Vector3d& light, int y, int x) {
  return 0.45 + 0.1 * light.x() + 0.08 * light.y() * light.y() + 0.01 * x - 0.012 * y +
         0.01 * x * light.y();
}

class FitPipeline : public ::testing::Test {
 protected:
  FitPipeline() {
    testing::write_capture(
        folder_ / "pictures", testing::spiral_directions(kLights, 0.3), kSize, ".png",
        [](const Vector3d& light, int y, int x) {
          return double{linear_from_srgb(static_cast<float>(coded_value(light, y, x)))};
        });
    options_.capture = folder_ / "pictures";
    options_.lights = folder_ / "pictures/lights.lp";
    options_.form = FitForm::ptm;
    options_.forms.ridge = 0.0;
  }

  testing::TemporaryFolder folder_;
  FitOptions options_;
};

TEST_F(FitPipeline, APolynomialIsPredictedAtLightsThatWereHeldOut) {
  options_.out = folder_ / "made.ptm";
  options_.hold_out = {4, 1};
  const FitSummary summary = fit_capture(options_);
  ASSERT_EQ(summary.fits.size(), 1U);
  const FormFit& fit = summary.fits.front();
  EXPECT_EQ(fit.score.form, FitForm::ptm);
  EXPECT_EQ(fit.n_planes, 18);
  EXPECT_EQ(fit.n_pixels, kSize.width * kSize.height);
  EXPECT_EQ(summary.truth, FitTruth::held);
  EXPECT_EQ(summary.n_fitted_lights, kLights - kLights / 4);
  EXPECT_EQ(fit.psnr_db.size(), static_cast<std::size_t>(kLights / 4));
  EXPECT_GT(fit.mean_psnr_db(), kOneStepDb);
  ASSERT_TRUE(fit.file.has_value());
  EXPECT_EQ(fit.file->bytes, bytes_on_disk(options_.out));
  EXPECT_EQ(summary.notes.size(), 0U);
}

TEST_F(FitPipeline, TheFileIsLitAsThePolynomialIs) {
  options_.out = folder_ / "made.ptm";
  (void)fit_capture(options_);
  const Vector3d light = Vector3d(0.3, -0.4, 1.0).normalized();
  const Image<float> picture = relit(read_reflectance(options_.out), light);
  for (int y = 0; y < kSize.height; ++y) {
    for (int x = 0; x < kSize.width; ++x) {
      // The photographs' and the planes' rounding, half a step each.
      EXPECT_NEAR(double{picture(y, x, 0)}, coded_value(light, y, x), 1.0 / 255.0);
    }
  }
}

TEST_F(FitPipeline, APolynomialLeftOutIsKnownToItsPhotographsRounding) {
  options_.out = folder_ / "made.ptm";
  // A photograph's value is off by up to half a step, 1 / sqrt(12) steps rms. Of a least-squares
  // fit with p terms to n lights, what is left at a light that was left out is larger by
  // 1 / (1 - h), whose mean is about n / (n - p): h has mean p / n.
  const double rounding_db = 20.0 * std::log10(255.0 * std::sqrt(12.0));
  const double larger_db = 10.0 * std::log10(double{kLights} / (kLights - 6));
  const FitSummary summary = fit_capture(options_);
  // 1 dB: 1152 values of rounding, 4 % of their variance; h is not even over the lights.
  EXPECT_NEAR(summary.fits.front().score.psnr_db, rounding_db - larger_db, 1.0);
}

TEST_F(FitPipeline, ComparingTellsEachFormAndLeavesNoFile) {
  options_.form = {};
  std::vector<FitForm> told;
  const FitSummary summary = compare_fits(options_, [&](FitTruth truth, const FormFit& fit) {
    EXPECT_EQ(truth, FitTruth::fitted);
    told.push_back(fit.score.form);
  });
  EXPECT_EQ(told.size(), all_values<FitForm>().size());
  ASSERT_EQ(summary.fits.size(), told.size());
  for (std::size_t i = 0; i < told.size(); ++i) {
    EXPECT_EQ(summary.fits[i].score.form, told[i]);
    EXPECT_TRUE(i == 0 || summary.fits[i].score.psnr_db <= summary.fits[i - 1].score.psnr_db);
  }
  EXPECT_EQ(bytes_on_disk(folder_.path()), bytes_on_disk(options_.capture));
  const std::vector<TradeoffRecord> records = fit_records(summary, 2, "a command");
  ASSERT_EQ(records.size(), told.size());
  EXPECT_EQ(records.front().conditions.lights, kLights);
  EXPECT_EQ(records.front().conditions.threads, 2);
}

TEST_F(FitPipeline, ASessionsRectangleAndNothingToDoAreRefused) {
  EXPECT_THROW((void)fit_capture(options_), Error);
  options_.out = folder_ / "made.ptm";
  options_.lights.clear();
  options_.crop = PixelRectangle{0, 0, 2, 2};
  EXPECT_THROW((void)fit_capture(options_), Error);
}

TEST_F(FitPipeline, WhatAFileCannotHoldIsRefusedBeforeItIsWritten) {
  options_.out = folder_ / "made.rti";
  EXPECT_THROW((void)fit_capture(options_), Error);
  EXPECT_FALSE(std::filesystem::exists(options_.out));
}

TEST_F(FitPipeline, NearLightsNeedPositionsAndHoldNothingOut) {
  options_.out = folder_ / "made.ptm";
  options_.near = NearSolve::exact;
  EXPECT_THROW((void)fit_capture(options_), Error);  // directions
  EXPECT_THROW((void)compare_fits(options_), Error);
  options_.hold_out = {4, 1};
  EXPECT_THROW((void)fit_capture(options_), Error);
  EXPECT_FALSE(std::filesystem::exists(options_.out));
}

TEST_F(FitPipeline, AListAndAFolderThatDisagreeAreToldAsTheyAreFound) {
  write_image(folder_ / "pictures/other.png", Image<float>(6, 8, 1).view());
  options_.out = folder_ / "made.ptm";
  std::vector<PipelineNote> told;
  options_.settings.tell = [&](const PipelineNote& note) { told.push_back(note); };
  const FitSummary summary = fit_capture(options_);
  EXPECT_GE(told.size(), 1U);
  EXPECT_EQ(summary.notes, told);
}

}  // namespace
}  // namespace haarlight::relight
