// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/relight_pipeline.h"

#include <filesystem>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "relight/pipeline/compress_pipeline.h"
#include "tests/relight/pipeline/ramp_session.h"

namespace haarlight::relight {
namespace {

using testing::RampSession;
using testing::TemporaryFolder;

/// The ramp, compressed; by default without loss.
RelightPictureOptions ramp_options(const TemporaryFolder& folder, double max_error = 0.0) {
  RampSession{}.write(folder / "ramp.session");
  CompressCaptureOptions compress;
  compress.session = folder / "ramp.session";
  compress.output = folder / "ramp.hlb";
  compress.plate = "none";
  compress.basis = BasisKind::direct;
  compress.max_error = max_error;
  (void)compress_capture(compress);
  RelightPictureOptions options;
  options.basis = compress.output;
  options.output = folder / "relit.exr";
  return options;
}

TEST(RelightPipeline, IsTheSumOfTheLightsTimesTheirDrives) {
  const TemporaryFolder folder;
  RelightPictureOptions options = ramp_options(folder);
  options.light.lights = {"1=0.5", "4"};
  options.against = folder / "ramp.session";
  const RelightSummary summary = relight_picture(options);
  EXPECT_LT(summary.relative_l2_bound, 1e-6);  // float sums
  ASSERT_EQ(summary.channel_bounds.size(), 1U);
  EXPECT_TRUE(summary.is_error_kept);
  EXPECT_FALSE(summary.missing_share);
  EXPECT_EQ(summary.exposure, 1.0);
  EXPECT_EQ(summary.terms_all, 2);  // direct: a term a light that burns
  EXPECT_EQ(summary.bytes, std::filesystem::file_size(options.output));
  ASSERT_TRUE(summary.against);
  EXPECT_LT(summary.against->relative_l2, 1e-6);
  const Image<float> picture = read_linear_image(options.output);
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      const double expected = 0.5 * RampSession::value(y, x, 1) + RampSession::value(y, x, 4);
      EXPECT_NEAR(picture(y, x), expected, 1e-6 * expected) << y << " " << x;
    }
  }
}

TEST(RelightPipeline, ShowsADisplayPictureByItsBrightestValues) {
  const TemporaryFolder folder;
  RelightPictureOptions options = ramp_options(folder);
  options.output = folder / "relit.png";
  options.light.lights = {"0"};
  options.stops = 1.0;
  const RelightSummary summary = relight_picture(options);
  // Of 48 values the 99.5th percentile is the 46th from the darkest, counted from 0.
  EXPECT_NEAR(summary.exposure, 2.0 / RampSession::value(5, 6, 0), 1e-4);
}

TEST(RelightPipeline, SaysWhenAnErrorCannotBePromised) {
  const TemporaryFolder folder;
  RelightPictureOptions options = ramp_options(folder, 0.05);
  options.light.lights = {"0"};
  options.max_error = 1e-6;  // less than the file's own
  const RelightSummary summary = relight_picture(options);
  EXPECT_FALSE(summary.is_error_kept);
  EXPECT_EQ(summary.notes.back().kind, NoteKind::warning);
}

TEST(RelightPipeline, WantsOneLightAndAnEnvironmentForFrames) {
  const TemporaryFolder folder;
  RelightPictureOptions options = ramp_options(folder);
  EXPECT_THROW((void)relight_picture(options), Error);
  options.light.lights = {"0"};
  options.frames = 3;
  EXPECT_THROW((void)relight_picture(options), Error);
  EXPECT_FALSE(std::filesystem::exists(options.output));
}

}  // namespace
}  // namespace haarlight::relight
