// SPDX-License-Identifier: Apache-2.0
/// @file
/// Dark frames, flat field and drift by themselves, on sessions made by hand.

#include "session/develop/dark_model.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/session/develop/develop.h"
#include "session/develop/drift_model.h"
#include "session/develop/flat_field.h"
#include "tests/session/small_session.h"

namespace haarlight::session {
namespace {

using test::TemporaryFolder;
using testing::HasSubstr;

constexpr int kWidth = 16;
constexpr int kHeight = 12;

struct Dark {
  double exposure_us = 1000.0;
  std::int64_t time = 0;
  double level = 0.0;
  std::optional<double> temperature_c{};
};

/// A session object that is never read from disk, for level_of.
Session with_darks(const TemporaryFolder& folder, const std::vector<Dark>& darks) {
  SessionInfo info = test::small_info(1);
  info.form.width = kWidth;
  info.form.height = kHeight;
  info.form.stored_height = kHeight;
  info.shots.clear();
  for (const Dark& dark : darks) {
    info.shots.push_back(
        Shot{static_cast<int>(info.shots.size()), ShotKind::dark, {}, dark.exposure_us});
  }
  test::make_session(folder.path() / "s", info, [&](int shot) {
    Image<std::uint16_t> pixels(kHeight, kWidth, 1);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        // The pattern's mean is the level: columns from 0 to twice of it.
        const double fraction = 2.0 * x / (kWidth - 1.0);
        pixels(y, x) = static_cast<std::uint16_t>(
            std::lround(64.0 + fraction * darks[static_cast<std::size_t>(shot)].level));
      }
    }
    return pixels;
  });
  return Session::open(folder.path() / "s");
}

/// Frames with the times and temperatures of the list (the session on disk knows neither).
std::vector<FrameRecord> records(const Session& session, const std::vector<Dark>& darks) {
  std::vector<FrameRecord> frames = session.info().frames;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    frames[i].evidence.kind = EvidenceKind::measured;
    frames[i].evidence.t_exposure_start_ns = darks[i].time;
    frames[i].evidence.temperature_c = darks[i].temperature_c;
  }
  return frames;
}

DarkModel model(const Session& session, const std::vector<FrameRecord>& frames,
                bool is_measured = true) {
  std::vector<const FrameRecord*> pointers;
  for (const FrameRecord& frame : frames) {
    pointers.push_back(&frame);
  }
  SensorResponse response;
  response.black_dn = 64.0;
  response.white_dn = 4095.0;
  response.clip_dn = 4095.0;
  response.is_measured = is_measured;
  const Lineariser linear(session.info().form, Transfer::linear, response);
  return {session, pointers, linear, response};
}

FrameRecord frame_at(double exposure_us, std::int64_t time,
                     std::optional<double> temperature_c = {}) {
  FrameRecord frame;
  frame.evidence.exposure_read_us = exposure_us;
  frame.evidence.t_exposure_start_ns = time;
  frame.evidence.temperature_c = temperature_c;
  return frame;
}

TEST(DarkModel, IsLinearInTimeBetweenItsFrames) {
  TemporaryFolder folder;
  const std::vector<Dark> darks = {{1000.0, 0, 10.0}, {1000.0, 1000, 30.0}};
  const Session session = with_darks(folder, darks);
  const auto frames = records(session, darks);
  const DarkModel dark = model(session, frames);
  EXPECT_NEAR(dark.level_of(session, frame_at(1000.0, 0)), 10.0, 0.3);  // words are whole
  EXPECT_NEAR(dark.level_of(session, frame_at(1000.0, 250)), 15.0, 0.3);
  EXPECT_NEAR(dark.level_of(session, frame_at(1000.0, 5000)), 30.0, 0.3);
  // Each pixel follows its own slope: column 15 has twice the level, column 0 none.
  EXPECT_TRUE(dark.has_slope());
  EXPECT_NEAR(dark.at(0, 20.0), 0.0, 0.6);
  EXPECT_NEAR(dark.at(15, 20.0), 40.0, 0.6);
  EXPECT_NEAR(dark.at(15, 10.0), 20.0, 0.6);
}

TEST(DarkModel, IsLinearInTheExposureAndBeyond) {
  TemporaryFolder folder;
  const std::vector<Dark> darks = {{1000.0, 0, 14.0}, {4000.0, 10, 44.0}, {9000.0, 20, 94.0}};
  const Session session = with_darks(folder, darks);
  const auto frames = records(session, darks);
  const DarkModel dark = model(session, frames);
  EXPECT_EQ(dark.n_exposures(), 3);
  EXPECT_NEAR(dark.level_of(session, frame_at(2000.0, 5)), 24.0, 0.5);
  EXPECT_NEAR(dark.level_of(session, frame_at(6000.0, 5)), 64.0, 0.5);
  EXPECT_NEAR(dark.level_of(session, frame_at(500.0, 5)), 9.0, 0.5);
  EXPECT_NEAR(dark.level_of(session, frame_at(12000.0, 5)), 124.0, 0.8);
}

TEST(DarkModel, OneExposureGrowsFromBlackWhereBlackIsKnown) {
  TemporaryFolder folder;
  const std::vector<Dark> darks = {{1000.0, 0, 10.0}};
  const Session session = with_darks(folder, darks);
  const auto frames = records(session, darks);
  EXPECT_NEAR(model(session, frames).level_of(session, frame_at(4000.0, 9)), 40.0, 0.5);
  EXPECT_NEAR(model(session, frames, false).level_of(session, frame_at(4000.0, 9)), 10.0, 0.3);
}

TEST(DarkModel, OutsideOfItsTimesTheTemperatureDecides) {
  TemporaryFolder folder;
  const std::vector<Dark> darks = {{1000.0, 0, 10.0, 25.0}, {1000.0, 1000, 30.0, 35.0}};
  const Session session = with_darks(folder, darks);
  const auto frames = records(session, darks);
  const DarkModel dark = model(session, frames);
  EXPECT_NEAR(dark.level_of(session, frame_at(1000.0, 90000, 27.5)), 15.0, 0.3);
  EXPECT_NEAR(dark.level_of(session, frame_at(1000.0, 90000)), 30.0, 0.3);
  // Between two dark frames time is the better guide: it sees everything that drifts.
  EXPECT_NEAR(dark.level_of(session, frame_at(1000.0, 500, 25.0)), 20.0, 0.3);
}

TEST(DarkModel, RefusesAMixOfGains) {
  TemporaryFolder folder;
  const std::vector<Dark> darks = {{1000.0, 0, 10.0}, {1000.0, 1000, 30.0}};
  const Session session = with_darks(folder, darks);
  auto frames = records(session, darks);
  FrameRecord light = frame_at(1000.0, 5);
  light.evidence.gain_db = 6.0;
  light.file = "frames/x.tif";
  EXPECT_THROW((void)model(session, frames).level_of(session, light), Error);
  frames[1].evidence.gain_db = 6.0;
  EXPECT_THROW((void)model(session, frames), Error);
}

/// A session of flat frames: bright at the middle, one pixel of 16 worth 10 % less.
Session flat_session(const TemporaryFolder& folder, double level, bool is_smooth_lit) {
  SessionInfo info = test::small_info(1);
  info.form.width = 64;
  info.form.height = 48;
  info.form.stored_height = 48;
  info.shots = {Shot{0, ShotKind::flat, {{0, 65535}}, 1000.0}};
  test::make_session(folder.path() / "flat", info, [&](int) {
    Image<std::uint16_t> pixels(48, 64, 1);
    for (int y = 0; y < 48; ++y) {
      for (int x = 0; x < 64; ++x) {
        const double light =
            is_smooth_lit
                ? 1.0 - 0.4 * (std::pow((x - 32) / 40.0, 2) + std::pow((y - 24) / 40.0, 2))
                : 1.0;
        const double pixel = (x + 3 * y) % 16 == 0 ? 0.9 : 1.0;
        pixels(y, x) = static_cast<std::uint16_t>(std::lround(64.0 + level * light * pixel));
      }
    }
    return pixels;
  });
  return Session::open(folder.path() / "flat");
}

FlatField flat_of(const Session& session, FlatKind kind, BadPixelMap& bad) {
  const SensorResponse response = sensor_response(session);
  const Lineariser linear(session.info().form, Transfer::linear, response);
  return measure_flat(session, {&session.info().frames[0]}, DarkModel(), linear, response, kind,
                      bad);
}

TEST(FlatField, WholeKeepsAllOfIt) {
  TemporaryFolder folder;
  BadPixelMap bad;
  const FlatField flat = flat_of(flat_session(folder, 3000.0, false), FlatKind::whole, bad);
  EXPECT_NEAR(flat.relative(0, 0) / flat.relative(0, 1), 0.9, 1e-3);
  EXPECT_NEAR(flat.least, 0.9056, 1e-3);
  EXPECT_EQ(bad.n_dead, 0);
}

TEST(FlatField, FineKeepsThePixelsAndForgetsTheLight) {
  TemporaryFolder folder;
  BadPixelMap bad;
  const FlatField flat = flat_of(flat_session(folder, 3000.0, true), FlatKind::fine, bad);
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 64; ++x) {
      const double pixel = ((x + 3 * y) % 16 == 0 ? 0.9 : 1.0) / (1.0 - 0.1 / 16.0);
      EXPECT_NEAR(flat.relative(y, x), pixel, 0.01) << x << " " << y;
    }
  }
}

TEST(FlatField, RefusesClippedFramesAndNoLight) {
  TemporaryFolder folder;
  BadPixelMap bad;
  EXPECT_THROW((void)flat_of(flat_session(folder, 6000.0, false), FlatKind::whole, bad), Error);
}

TEST(SensorResponse, RefusesABlackLevelAboveThePicture) {
  TemporaryFolder folder;
  SessionInfo info = test::small_info(1);
  info.form.black_level = 2000.0;
  test::make_session(folder.path() / "s", info, [](int) {
    Image<std::uint16_t> pixels(test::kSmallStored, test::kSmallWidth, 1);
    for (std::uint16_t& word : pixels.pixels()) {
      word = 500;
    }
    pixels(0, 0) = 501;
    return pixels;
  });
  try {
    (void)develop(Session::open(folder.path() / "s"));
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), HasSubstr("is above the mean of every frame"));
    EXPECT_THAT(error.hint(), HasSubstr("haarlight rig commission"));
  }
}

TEST(StandardError, IsRefusedWithoutAMeasuredNoise) {
  TemporaryFolder folder;
  test::make_small_session(folder.path() / "s", 2);
  try {
    (void)develop_all(Session::open(folder.path() / "s"), {.has_standard_error = true});
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), HasSubstr("noise is not known"));
    EXPECT_THAT(error.hint(), HasSubstr("haarlight rig commission"));
  }
}

TEST(Develop, AllBlackAndSixteenBracketsAreNoSpecialCase) {
  TemporaryFolder folder;
  SessionInfo info = test::small_info(1);
  info.shots.clear();
  for (int i = 0; i < 16; ++i) {
    info.shots.push_back(Shot{i, ShotKind::light, {{0, 65535}}, 100.0 * (i + 1)});
  }
  test::make_session(folder.path() / "s", info, [](int shot) {
    Image<std::uint16_t> pixels(test::kSmallStored, test::kSmallWidth, 1);
    for (std::uint16_t& word : pixels.pixels()) {
      word = 64;
    }
    pixels(0, 0) = static_cast<std::uint16_t>(64 + 20 * (shot + 1));
    return pixels;
  });
  const LightStack stack = develop(Session::open(folder.path() / "s"));
  const Image<float> image = stack.light_images(0, 1).front();
  EXPECT_EQ(image(3, 3), 0.0F);
  EXPECT_NEAR(image(0, 0), 20.0 / (4095.0 - 64.0) / 100e-6, 1e-3);
}

}  // namespace
}  // namespace haarlight::session
