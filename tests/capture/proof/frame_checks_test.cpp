// SPDX-License-Identifier: Apache-2.0
#include "capture/proof/frame_checks.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/daemon/writer_thread.h"
#include "core/random.h"
#include "haarlight/core/rig/rig.h"
#include "session/clip_level.h"
#include "tests/drawn_seed.h"

namespace haarlight::capture {
namespace {

using ::testing::HasSubstr;

constexpr int kWidth = 40;
constexpr int kHeight = 30;

session::FrameForm form_of_12_bits() {
  session::FrameForm form;
  form.width = kWidth;
  form.height = kHeight;
  form.stored_height = kHeight;
  form.black_level = 64.0;
  form.white_level = 4095.0;
  return form;
}

/// Light 0 in two exposures, light 1 once, a dark.
Plan plan_of(FrameLimits limits) {
  Plan plan;
  plan.n_lights = 2;
  plan.limits = limits;
  plan.shots = {session::Shot{0, session::ShotKind::light, {{0, 65535}}, 1000.0},
                session::Shot{1, session::ShotKind::light, {{1, 65535}}, 1000.0},
                session::Shot{2, session::ShotKind::light, {{0, 65535}}, 8000.0},
                session::Shot{3, session::ShotKind::dark, {}, 8000.0}};
  return plan;
}

/// Pixels 64 + exposure x radiance, from `level` to twice that at the shortest exposure.
Image<std::uint16_t> picture(double level, double exposure_us, double black = 64.0) {
  Image<std::uint16_t> pixels(kHeight, kWidth, 1);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const double radiance = level * (1.0 + static_cast<double>(x) / kWidth);
      pixels(y, x) = static_cast<std::uint16_t>(
          std::lround(std::min(4095.0, black + radiance * exposure_us / 1000.0)));
    }
  }
  return pixels;
}

FrameFinding check(FrameChecker& checker, int shot, const Image<std::uint16_t>& pixels,
                   double exposure_us, session::FrameEvidence* out = nullptr) {
  session::FrameEvidence evidence;
  evidence.exposure_read_us = exposure_us;
  FrameFinding finding = checker.check(shot, pixels.view(), evidence);
  if (out != nullptr) {
    *out = evidence;
  }
  return finding;
}

TEST(FrameChecker, TakesAFrameAndCompletesItsEvidence) {
  FrameChecker checker(plan_of({}), form_of_12_bits());
  session::FrameEvidence evidence;
  const FrameFinding found = check(checker, 0, picture(200.0, 1000.0), 1000.0, &evidence);
  EXPECT_TRUE(found.is_taken()) << found.problem;
  EXPECT_EQ(evidence.verdict, session::FrameVerdict::good);
  EXPECT_EQ(evidence.min_dn, 264);
  EXPECT_EQ(evidence.pixel_hash.size(), 32U);
}

TEST(FrameChecker, NeverTakesAFrameWithoutAPicture) {
  FrameChecker checker(plan_of({.attempts = 1}), form_of_12_bits());
  Image<std::uint16_t> pixels(kHeight, kWidth, 1);
  for (std::uint16_t& word : pixels.pixels()) {
    word = 700;
  }
  for (int attempt = 0; attempt < 3; ++attempt) {
    const FrameFinding found = check(checker, 0, pixels, 1000.0);
    EXPECT_EQ(found.verdict, session::FrameVerdict::no_picture);
    EXPECT_THAT(found.problem, HasSubstr("every pixel is 700"));
  }
}

TEST(FrameChecker, RefusesClippingInTheShortestExposureOnly) {
  FrameChecker checker(plan_of({.max_saturated_fraction = 0.01}), form_of_12_bits());
  const FrameFinding found = check(checker, 0, picture(3000.0, 1000.0), 1000.0);
  EXPECT_EQ(found.verdict, session::FrameVerdict::saturated);
  EXPECT_THAT(found.problem, HasSubstr("max_saturated_share"));
  EXPECT_EQ(check(checker, 2, picture(3000.0, 8000.0), 8000.0).verdict,
            session::FrameVerdict::good);
}

TEST(FrameChecker, ClippingBeginsBelowWhereTheConverterEnds) {
  for (const char* name : {"small8", "cube32", "strobe60"}) {
    const Rig rig =
        read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/" + std::string(name) + ".toml");
    session::FrameForm form = session_info_of(rig, plan_of({}), "s").form;
    const double clip = session::clip_level(rig.cameras.front());
    ASSERT_LT(clip, form.white_level) << name;
    form.width = kWidth;
    form.height = kHeight;
    FrameChecker checker(plan_of({.max_saturated_fraction = 0.01, .attempts = 5}), form);
    // Every pixel just below, but for the noise of one.
    const auto word = static_cast<std::uint16_t>(std::ceil(clip) - 1.0);
    Image<std::uint16_t> pixels(kHeight, kWidth, 1);
    std::fill(pixels.pixels().begin(), pixels.pixels().end(), word);
    pixels(0, 0) = static_cast<std::uint16_t>(word - 1);
    session::FrameEvidence evidence;
    EXPECT_TRUE(check(checker, 0, pixels, 1000.0, &evidence).is_taken()) << name;
    EXPECT_EQ(evidence.saturated_fraction, 0.0) << name;
    for (std::uint16_t& value : pixels.pixels()) {
      ++value;
    }
    FrameFinding found = check(checker, 0, pixels, 1000.0, &evidence);
    EXPECT_EQ(found.verdict, session::FrameVerdict::saturated) << name;
    EXPECT_GT(evidence.saturated_fraction, 0.99) << name;
    // Full everywhere: saturated, not a camera without a picture.
    std::fill(pixels.pixels().begin(), pixels.pixels().end(),
              static_cast<std::uint16_t>(std::ceil(clip) + 10.0));
    found = check(checker, 0, pixels, 1000.0);
    EXPECT_EQ(found.verdict, session::FrameVerdict::saturated) << name;
  }
}

TEST(FrameChecker, APixelAtTheFullWellDoesNotCountForTheLevel) {
  session::FrameForm form = form_of_12_bits();
  form.clip_level = 1500.0;
  FrameChecker checker(plan_of({}), form);
  ASSERT_TRUE(check(checker, 0, picture(300.0, 1000.0), 1000.0).is_taken());
  Image<std::uint16_t> full = picture(300.0, 8000.0);
  for (std::uint16_t& word : full.pixels()) {
    word = std::min<std::uint16_t>(word, 1600);
  }
  EXPECT_EQ(check(checker, 2, full, 8000.0).verdict, session::FrameVerdict::good);
}

TEST(FrameChecker, RefusesDarknessInTheLongestExposureOnly) {
  FrameChecker checker(plan_of({.min_signal_fraction = 0.05}), form_of_12_bits());
  EXPECT_EQ(check(checker, 0, picture(5.0, 1000.0), 1000.0).verdict,
            session::FrameVerdict::good);
  const FrameFinding found = check(checker, 2, picture(5.0, 8000.0), 8000.0);
  EXPECT_EQ(found.verdict, session::FrameVerdict::too_dark);
  EXPECT_THAT(found.problem, HasSubstr("min_signal_share"));
}

TEST(FrameChecker, TheLastAttemptStandsWithItsVerdict) {
  FrameChecker checker(plan_of({.max_saturated_fraction = 0.0, .attempts = 3}),
                       form_of_12_bits());
  const Image<std::uint16_t> bright = picture(3000.0, 1000.0);
  session::FrameEvidence evidence;
  EXPECT_FALSE(check(checker, 0, bright, 1000.0, &evidence).is_taken());
  EXPECT_EQ(evidence.verdict, session::FrameVerdict::saturated);
  EXPECT_FALSE(check(checker, 0, bright, 1000.0).is_taken());
  const FrameFinding last = check(checker, 0, bright, 1000.0, &evidence);
  EXPECT_TRUE(last.is_taken());
  EXPECT_EQ(last.verdict, session::FrameVerdict::saturated);
  EXPECT_EQ(evidence.verdict, session::FrameVerdict::saturated);
  // Taken again by the operator: the count begins anew.
  EXPECT_FALSE(check(checker, 0, bright, 1000.0).is_taken());
}

TEST(FrameChecker, AnotherExposureMustRiseByTheRatio) {
  FrameChecker checker(plan_of({}), form_of_12_bits());
  ASSERT_TRUE(check(checker, 0, picture(200.0, 1000.0), 1000.0).is_taken());
  // The camera says 8000 us and still exposed 1000 us: the bracket change did not act yet.
  const FrameFinding found = check(checker, 2, picture(200.0, 1000.0), 8000.0);
  EXPECT_EQ(found.verdict, session::FrameVerdict::wrong_level);
  EXPECT_THAT(found.problem, HasSubstr("0.125 of the level that shot 0 predicts"));
  EXPECT_TRUE(check(checker, 2, picture(200.0, 8000.0), 8000.0).is_taken());
}

TEST(FrameChecker, ClippedSamplesDoNotCountForTheLevel) {
  FrameChecker checker(plan_of({}), form_of_12_bits());
  // A third of the columns clip in the long exposure.
  ASSERT_TRUE(check(checker, 0, picture(300.0, 1000.0), 1000.0).is_taken());
  EXPECT_EQ(check(checker, 2, picture(300.0, 8000.0), 8000.0).verdict,
            session::FrameVerdict::good);
  // Where all would clip nothing is proved, and nothing refused.
  FrameChecker bright(plan_of({}), form_of_12_bits());
  ASSERT_TRUE(check(bright, 0, picture(1500.0, 1000.0), 1000.0).is_taken());
  EXPECT_EQ(check(bright, 2, picture(1500.0, 8000.0), 8000.0).verdict,
            session::FrameVerdict::good);
}

TEST(FrameChecker, ADarkFrameStandsForAWrongBlackLevel) {
  FrameChecker checker(plan_of({}), form_of_12_bits());
  // The sensor's black is 364, the rig file says 64.
  ASSERT_TRUE(check(checker, 3, picture(0.5, 8000.0, 364.0), 8000.0).is_taken());
  ASSERT_TRUE(check(checker, 0, picture(100.0, 1000.0, 364.0), 1000.0).is_taken());
  EXPECT_EQ(check(checker, 2, picture(100.0, 8000.0, 364.0), 8000.0).verdict,
            session::FrameVerdict::good);
  FrameChecker blind(plan_of({}), form_of_12_bits());
  ASSERT_TRUE(check(blind, 0, picture(100.0, 1000.0, 364.0), 1000.0).is_taken());
  EXPECT_EQ(check(blind, 2, picture(100.0, 8000.0, 364.0), 8000.0).verdict,
            session::FrameVerdict::wrong_level);
}

TEST(FrameChecker, ToleranceZeroSwitchesTheLevelCheckOff) {
  FrameChecker checker(plan_of({.level_tolerance = 0.0}), form_of_12_bits());
  ASSERT_TRUE(check(checker, 0, picture(200.0, 1000.0), 1000.0).is_taken());
  EXPECT_TRUE(check(checker, 2, picture(200.0, 1000.0), 8000.0).is_taken());
}

TEST(FrameLimits, TravelWithThePlanAndDefaultsLeaveOldHashesAlone) {
  Plan plan = plan_of({});
  const std::string plain = plan_to_json(plan);
  EXPECT_EQ(plain.find("limits"), std::string::npos);
  EXPECT_EQ(plan_from_json(plain, "plan.json").limits, FrameLimits{});
  plan.limits = {.max_saturated_fraction = 0.02, .min_signal_fraction = 0.1, .attempts = 5};
  EXPECT_EQ(plan_from_json(plan_to_json(plan), "plan.json").limits, plan.limits);
}

TEST(FrameChecker, TakesDimFramesWhoseNoiseIsTheirSignal) {
  // 40 steps, 1 % of the range, with a noise of 12: chosen by themselves, the samples that
  // count would be those whose noise was high in the first frame.
  const std::uint64_t seed = testing::drawn_seed();
  for (std::uint64_t i = 0; i < 100; ++i) {
    FrameChecker checker(plan_of({}), form_of_12_bits());
    const double level = 20.0 + 40.0 * uniform_unit(hash_key(seed, i));
    for (int shot = 0; shot < 3; shot += 2) {
      const double exposure_us = shot == 0 ? 1000.0 : 1500.0;
      Image<std::uint16_t> pixels = picture(level, exposure_us);
      std::uint64_t n = 0;
      for (std::uint16_t& word : pixels.pixels()) {
        const auto key = hash_key(seed, i, static_cast<std::uint64_t>(shot), ++n);
        word = static_cast<std::uint16_t>(
            std::max(0L, std::lround(word + 12.0 * standard_normal(key))));
      }
      const FrameFinding found = check(checker, shot, pixels, exposure_us);
      EXPECT_TRUE(found.is_taken()) << level << ": " << found.problem;
    }
  }
}

}  // namespace
}  // namespace haarlight::capture
