// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/relight_pipeline.h"

#include <algorithm>
#include <filesystem>
#include <optional>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/tolerance.h"
#include "relight/pipeline/compress_pipeline.h"
#include "relight/pipeline/relit_picture.h"
#include "tests/relight/pipeline/made_capture.h"
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

TEST(RelightPipeline, IsTheSumOfTheLightsTimesTheirWeights) {
  const TemporaryFolder folder;
  RelightPictureOptions options = ramp_options(folder);
  options.light.lights = {"1=0.5", "4"};
  options.against = folder / "ramp.session";
  const RelightSummary summary = relight_picture(options);
  EXPECT_LT(summary.relative_l2_bound, 1e-6);  // float sums
  ASSERT_EQ(summary.channel_bounds.size(), 1U);
  EXPECT_TRUE(summary.is_error_kept);
  EXPECT_FALSE(summary.missing_fraction);
  EXPECT_EQ(summary.exposure, 1.0);
  EXPECT_EQ(summary.terms_all, 2);  // direct: one term per light that is on
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
  EXPECT_EQ(summary.notes.back().kind, NoteKind::failure);
}

/// Frames of an exact file under a sky that is brighter on one side.
RelightPictureOptions frame_options(const TemporaryFolder& folder, int n_frames) {
  RelightPictureOptions options = ramp_options(folder);
  Image<float> sky(8, 16, 1);
  for (int y = 0; y < sky.height(); ++y) {
    for (int x = 0; x < sky.width(); ++x) {
      sky(y, x) = 1.0F + static_cast<float>(x);
    }
  }
  write_image(folder / "sky.exr", sky.view());
  options.light.cubemap = folder / "sky.exr";
  options.frames = n_frames;
  return options;
}

TEST(RelightPipeline, HoldsAnExactFileAsHalfFloatsForManyFrames) {
  const TemporaryFolder folder;
  RelightPictureOptions options = frame_options(folder, 8);
  const RelightSummary exact = relight_picture(options);
  EXPECT_EQ(exact.method, "file");
  EXPECT_EQ(exact.relative_l2_bound, 0.0);
  options.output = folder / "half.exr";
  options.max_error = 0.001;
  options.form = RelightForm::half;  // of so small a picture the predictions are close
  const RelightSummary half = relight_picture(options);
  EXPECT_EQ(half.method, "dense half");
  EXPECT_TRUE(half.is_error_kept);
  EXPECT_GT(half.relative_l2_bound, 0.0);
  EXPECT_LE(half.relative_l2_bound, 0.001);
  double worst = 0.0;
  for (int i = 0; i < 8; ++i) {
    const auto picture = [&](const char* name) {
      return read_linear_image(folder / fmt::format("{}-{:04}.exr", name, i));
    };
    worst = std::max(worst,
                     compare(picture("half").pixels(), picture("relit").pixels()).relative_l2);
  }
  EXPECT_GT(worst, 0.0);
  EXPECT_LE(worst, half.relative_l2_bound);
}

TEST(RelightPipeline, MeasuresTheSharperBoundOnlyForAsManyFramesAsPayForIt) {
  const TemporaryFolder folder;
  const BasisFile basis = BasisFile::open(ramp_options(folder, 0.05).basis);
  const auto bytes = [&](int n_frames, std::optional<double> max_error) {
    return Relighter(basis, {.use = RelighterPlan::Use::frames,
                             .n_frames = n_frames,
                             .max_error = max_error})
        .bytes();
  };
  const std::uint64_t without = bytes(1000, {});
  EXPECT_EQ(bytes(1, 0.1), without);
  EXPECT_GT(bytes(1000, 0.1), without);  // the products are in memory
}

TEST(RelightPipeline, ReadsAnExactFileOnceWhereHalfFloatsAreTooCoarseOrTooLarge) {
  const TemporaryFolder folder;
  RelightPictureOptions options = frame_options(folder, 8);
  options.output = folder / "fine.exr";
  options.max_error = 1e-4;  // a half float's rounding is 4.9e-4
  const RelightSummary fine = relight_picture(options);
  EXPECT_EQ(fine.method, "file");
  EXPECT_EQ(fine.relative_l2_bound, 0.0);
  options.output = folder / "no-room.exr";
  options.max_error = 0.1;
  options.settings.memory_bytes = 1000;
  EXPECT_EQ(relight_picture(options).method, "file");
  options.form = RelightForm::half;
  options.output = folder / "forced.exr";
  EXPECT_THROW((void)relight_picture(options), Error);
}

TEST(RelightPipeline, TakesTheFormOfLeastPredictedSecondsForFrames) {
  const TemporaryFolder folder;
  RelightPictureOptions options = frame_options(folder, 8);
  options.max_error = 0.1;
  const RelightSummary found = relight_picture(options);
  ASSERT_TRUE(found.choice);
  EXPECT_EQ(found.method, found.choice->form == RelightForm::half ? "dense half" : "file");
  EXPECT_EQ(found.choice->terms.size(), 8U);
  EXPECT_LE(found.relative_l2_bound, 0.1);
  EXPECT_GE(found.choice->all_seconds, 0.0);
}

TEST(RelightPipeline, PredictsNothingWhereTheSumOfAllTermsCostsLess) {
  const TemporaryFolder folder;
  RelightPictureOptions options = ramp_options(folder, 0.05);
  options.light.lights = {"0", "1=0.2", "3"};
  const RelightSummary plain = relight_picture(options);
  options.max_error = 0.5;
  options.output = folder / "within.exr";
  const RelightSummary found = relight_picture(options);  // one tile
  ASSERT_TRUE(found.choice);
  EXPECT_FALSE(found.choice->is_predicted);
  EXPECT_EQ(found.terms, plain.terms);
  EXPECT_EQ(found.relative_l2_bound, plain.relative_l2_bound);
  EXPECT_TRUE(found.is_error_kept);
  EXPECT_EQ(read_linear_image(options.output).pixels()[0],
            read_linear_image(folder / "relit.exr").pixels()[0]);
  options.max_error = 1e-6;
  options.output = folder / "never.exr";
  const RelightSummary never = relight_picture(options);
  EXPECT_FALSE(never.is_error_kept);
  EXPECT_EQ(never.relative_l2_bound, plain.relative_l2_bound);
}

TEST(RelightPipeline, SaysWhenATimeIsTooShortAndTakesTheCheapestWay) {
  const TemporaryFolder folder;
  RelightPictureOptions options = ramp_options(folder, 0.05);
  options.light.lights = {"0", "3"};
  options.seconds = 1e-9;
  const RelightSummary none = relight_picture(options);
  EXPECT_FALSE(none.is_time_enough);
  EXPECT_TRUE(none.is_error_kept);
  EXPECT_EQ(none.notes.back().kind, NoteKind::failure);
  EXPECT_EQ(none.terms, 1);  // the file has no plate: without a term the picture would be black
  options.seconds = 1e3;
  options.output = folder / "long.exr";
  options.against = folder / "ramp.session";
  const RelightSummary all = relight_picture(options);
  EXPECT_TRUE(all.is_time_enough);
  EXPECT_EQ(all.terms, all.terms_all);
  EXPECT_LE(all.against->relative_l2, all.relative_l2_bound);
  EXPECT_LT(all.relative_l2_bound, none.relative_l2_bound);
}

TEST(RelightPipeline, TakesOneOfErrorTermsAndTime) {
  const TemporaryFolder folder;
  RelightPictureOptions options = ramp_options(folder, 0.05);
  options.light.lights = {"0"};
  options.seconds = 1.0;
  options.max_error = 0.1;
  EXPECT_THROW((void)relight_picture(options), Error);
  options.max_error.reset();
  options.terms = 3;
  EXPECT_THROW((void)relight_picture(options), Error);
  options.seconds.reset();
  options.max_error = 0.1;
  EXPECT_THROW((void)relight_picture(options), Error);
  EXPECT_FALSE(std::filesystem::exists(options.output));
}

/// Of four lights around the object one is 1e10 times brighter: half floats in its units hold the
/// others in steps of 2^-24, a hundredth of their values.
TEST(RelightPipeline, SumsFramesFromTheFileWhoseBoundIsAboveTheRequest) {
  const TemporaryFolder folder;
  const std::vector<Eigen::Vector3d> around{
      {0.6, 0.0, 0.8}, {0.0, 0.6, 0.8}, {-0.6, 0.0, 0.8}, {0.0, -0.6, 0.8}};
  testing::write_session(folder / "s", around, session::LightCoordinates::directions, {6, 5},
                         [](const Eigen::Vector3d& place, int y, int x) {
                           const double dim = 2.0 + place.x() + 0.5 * place.y();
                           return (place.x() > 0.5 ? 1e10 : dim) * (1.0 + 0.01 * (6 * y + x));
                         });
  CompressCaptureOptions compress;
  compress.session = folder / "s";
  compress.output = folder / "s.hlb";
  compress.plate = "none";
  compress.basis = BasisKind::direct;
  compress.max_error = 0.0;
  (void)compress_capture(compress);
  Image<float> sky(8, 16, 1);
  sky(2, 3) = 1.0F;  // within one light's cell in each frame
  write_image(folder / "sky.exr", sky.view());
  RelightPictureOptions options;
  options.basis = compress.output;
  options.output = folder / "exact.exr";
  options.light.cubemap = folder / "sky.exr";
  options.frames = 8;
  EXPECT_EQ(relight_picture(options).relative_l2_bound, 0.0);
  options.output = folder / "half.exr";
  options.max_error = 0.001;
  options.form = RelightForm::half;
  const RelightSummary half = relight_picture(options);
  EXPECT_TRUE(half.is_error_kept);
  EXPECT_GT(half.relative_l2_bound, 0.0);  // the bright light's frames
  int n_same = 0;
  for (int i = 0; i < 8; ++i) {
    const Image<float> a = read_linear_image(folder / fmt::format("exact-{:04}.exr", i));
    const Image<float> b = read_linear_image(folder / fmt::format("half-{:04}.exr", i));
    EXPECT_LE(compare(b.pixels(), a.pixels()).relative_l2, 0.001) << i;
    n_same += std::equal(a.pixels().begin(), a.pixels().end(), b.pixels().begin()) ? 1 : 0;
  }
  EXPECT_EQ(n_same, 6);  // three of four lights
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
