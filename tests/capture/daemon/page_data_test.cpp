// SPDX-License-Identifier: Apache-2.0
/// @file
/// What the page shows: marks, notes, words, histograms, pictures with clipping marked.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>
#include <zlib.h>

#include "capture/camera/camera.h"
#include "capture/daemon/frame_words.h"
#include "capture/daemon/preview_png.h"
#include "capture/daemon/run_observer.h"

namespace haarlight::capture {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

session::FrameForm small_form() {
  return {.width = 4,
          .height = 3,
          .stored_height = 3,
          .black_level = 256.0,
          .white_level = 16383.0};
}

session::FrameEvidence good_evidence() {
  session::FrameEvidence e;
  e.tag = e.tag_echo = 18;
  e.t_command_ns = 1'000'000'000;
  e.t_ack_ns = 1'001'000'000;
  e.t_stable_ns = 1'002'000'000;
  e.t_exposure_start_ns = 1'003'250'000;
  e.t_exposure_end_ns = 1'005'250'000;
  e.t_next_change_ns = 1'006'150'000;
  e.sequence = 77;
  e.flags = kFrameMonotonic;  // no damage
  e.exposure_requested_us = e.exposure_read_us = 2000.0;
  e.margin_us = 900.0;
  e.min_dn = 250;
  e.max_dn = 9000;
  e.mean_dn = 3000.0;
  return e;
}

TEST(FrameWords, SayTheTimesOfTheProof) {
  const auto words = describe_evidence(good_evidence(), small_form());
  EXPECT_THAT(words, Contains(HasSubstr("tag 18) before the exposure and again after it")));
  EXPECT_THAT(words,
              Contains(HasSubstr("began 1.25 ms after the light stood still and ended 900 "
                                 "µs before the next change of light; 900 µs to spare")));
  EXPECT_THAT(words, Contains(HasSubstr("Exposure 2.00 ms, as requested")));
  EXPECT_THAT(words, Contains("Frame 77 of the camera, undamaged and in sequence."));
  EXPECT_THAT(doubt_of(good_evidence(), small_form(), session::ShotKind::light), IsEmpty());
}

TEST(FrameWords, ClaimNoMeasurementForAnImport) {
  session::FrameEvidence e = good_evidence();
  e.kind = session::EvidenceKind::asserted;
  for (const std::string& words : describe_evidence(e, small_form())) {
    EXPECT_THAT(words, ::testing::Not(HasSubstr("confirmed")));
    EXPECT_THAT(words, ::testing::Not(HasSubstr("to spare")));
  }
}

TEST(FrameWords, SayWhatWasRequestedWhereTheCameraDidSomethingElse) {
  session::FrameEvidence e = good_evidence();
  e.exposure_read_us = 2500.0;
  EXPECT_THAT(describe_evidence(e, small_form()),
              Contains(HasSubstr("Exposure 2.50 ms where 2.00 ms was requested")));
}

TEST(FrameWords, DoubtSaturatedBlackAndCloseFrames) {
  session::FrameEvidence e = good_evidence();
  e.saturated_fraction = 0.02;
  EXPECT_THAT(doubt_of(e, small_form(), session::ShotKind::light),
              HasSubstr("2.00 % of the pixels"));
  e = good_evidence();
  e.black_fraction = 1.0;
  EXPECT_THAT(doubt_of(e, small_form(), session::ShotKind::light), HasSubstr("black"));
  EXPECT_THAT(doubt_of(e, small_form(), session::ShotKind::dark), IsEmpty());
  e = good_evidence();
  e.margin_us = 12.0;
  EXPECT_THAT(doubt_of(e, small_form(), session::ShotKind::light), HasSubstr("only 12 µs"));
}

TEST(Histogram, CountsEachValueInItsClassAndAllAbove) {
  Histogram histogram({0.1, 1.0});
  for (const double value : {0.05, 0.1, 0.5, 7.0}) {
    histogram.add(value);
  }
  EXPECT_EQ(histogram.text("x_seconds", "Help"),
            "# HELP haarlight_x_seconds Help\n# TYPE haarlight_x_seconds histogram\n"
            "haarlight_x_seconds_bucket{le=\"0.1\"} 2\nhaarlight_x_seconds_bucket{le=\"1\"} 3\n"
            "haarlight_x_seconds_bucket{le=\"+Inf\"} 4\nhaarlight_x_seconds_sum 7.65\n"
            "haarlight_x_seconds_count 4\n");
}

TEST(RunObserver, MarksEveryShotByStateAndNotes) {
  RunObserver observer;
  observer.begin(std::vector<session::ShotKind>(7, session::ShotKind::light), small_form(),
                 {0, 0, 0, 1, 2, 0, 0});
  session::FrameEvidence doubtful = good_evidence();
  doubtful.saturated_fraction = 0.5;
  observer.see(0, Action(action::CommitFrame{1, 5, 0, doubtful}));
  observer.see(
      0, Action(action::LogEvent{session::EventKind::retry, "no clean frame in time", 6}));
  using enum ShotState;
  const std::vector<ShotState> states{pending,   exposing,  checking, committed,
                                      committed, committed, pending};
  EXPECT_EQ(observer.marks(states), ".*~or?x");
  EXPECT_EQ(observer.note(6).problem, "no clean frame in time");
  observer.see(0, Action(action::WithdrawShots{{3}}));
  EXPECT_EQ(observer.marks({pending, pending, pending, pending}), "...w");
}

TEST(RunObserver, AGoodFrameEndsAProblem) {
  RunObserver observer;
  observer.begin({session::ShotKind::light}, small_form(), {0});
  observer.see(0, Action(action::LogEvent{session::EventKind::retry, "late", 0}));
  observer.see(0, Action(action::CommitFrame{1, 0, 1, good_evidence()}));
  EXPECT_EQ(observer.marks({ShotState::committed}), "r");
  EXPECT_THAT(observer.note(0).problem, IsEmpty());
}

TEST(RunObserver, MeasuresFromOrderToDurable) {
  RunObserver observer;
  observer.begin({session::ShotKind::light}, small_form(), {0});
  observer.see(1'000'000'000, Action(action::CommitFrame{9, 0, 0, good_evidence()}));
  observer.see(1'031'250'000, EventBody(event::FrameCommitted{9, 0}));  // 1/32 s: exact
  EXPECT_THAT(observer.metrics(), HasSubstr("haarlight_commit_seconds_sum 0.03125\n"));
  EXPECT_THAT(observer.metrics(),
              HasSubstr("haarlight_margin_seconds_bucket{le=\"0.001\"} 1\n"));
}

TEST(RunObserver, ShotsOfAnotherPlanAreNoConcern) {
  RunObserver observer;
  observer.see(
      0, Action(action::LogEvent{session::EventKind::retry, "a preview has no notes", 3}));
  observer.see(0, Action(action::CommitFrame{1, 100, 0, good_evidence()}));
  EXPECT_EQ(observer.marks({ShotState::pending}), ".");
}

Image<std::uint16_t> words_of(int height, int width, std::uint16_t value) {
  Image<std::uint16_t> words(height, width, 1);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      words(y, x) = value;
    }
  }
  return words;
}

TEST(PreviewCodes, ASingleSaturatedPixelShowsInItsBlock) {
  Image<std::uint16_t> words = words_of(9, 12, 1000);
  words(5, 7) = 4095;
  const Image<std::uint8_t> codes = make_preview_codes(words.view(), 64.0, 4095.0, 3);
  ASSERT_EQ(codes.height(), 3);
  ASSERT_EQ(codes.width(), 4);
  for (int y = 0; y < 3; ++y) {
    for (int x = 0; x < 4; ++x) {
      EXPECT_EQ(codes(y, x) == kCodeSaturated, y == 1 && x == 2) << y << ' ' << x;
    }
  }
  EXPECT_DOUBLE_EQ(saturated_fraction_of(codes.view()), 1.0 / 12.0);
}

TEST(PreviewCodes, ABlockIsBlackOnlyWhenAllOfItIs) {
  Image<std::uint16_t> words = words_of(2, 4, 64);
  words(1, 3) = 65;
  const Image<std::uint8_t> codes = make_preview_codes(words.view(), 64.0, 4095.0, 2);
  EXPECT_EQ(codes(0, 0), kCodeBlack);
  EXPECT_LT(codes(0, 1), kCodeBlack);
}

RC_GTEST_PROP(PreviewCodes, BrighterWordsNeverGetDarkerGreys,
              (std::uint16_t a, std::uint16_t b)) {
  const auto grey = [](std::uint16_t word) {
    return make_preview_codes(words_of(1, 1, word).view(), 0.0, 70000.0, 1)(0, 0);
  };
  RC_PRE(a > 0 && b >= a);
  RC_ASSERT(grey(a) <= grey(b));
}

TEST(PreviewCodes, MiddleGreyFollowsTheSrgbCurve) {
  // 0.2140 linear is 0.5 on the curve (IEC 61966-2-1).
  const auto word = static_cast<std::uint16_t>(std::lround(0.2140 * 65535.0));
  EXPECT_NEAR(make_preview_codes(words_of(1, 1, word).view(), 0.0, 65536.0, 1)(0, 0),
              0.5 * kCodeWhitest, 1.0);
}

std::uint32_t u32_at(const std::string& bytes, std::size_t at) {
  std::uint32_t value = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    value = value << 8U | static_cast<unsigned char>(bytes[at + i]);
  }
  return value;
}

TEST(PreviewPng, HoldsEveryCodeAndChecksOut) {
  Image<std::uint8_t> codes(16, 16, 1);
  for (int i = 0; i < 256; ++i) {
    codes(i / 16, i % 16) = static_cast<std::uint8_t>(i);
  }
  const std::string png = encode_preview_png(std::as_const(codes).view());
  ASSERT_EQ(png.substr(0, 8), "\x89PNG\r\n\x1a\n");
  std::string palette;
  std::string packed;
  for (std::size_t at = 8; at < png.size();) {
    const std::uint32_t size = u32_at(png, at);
    const std::string kind = png.substr(at + 4, 4);
    const std::string body = png.substr(at + 8, size);
    const std::string checked = kind + body;
    EXPECT_EQ(u32_at(png, at + 8 + size),
              ::crc32(0, reinterpret_cast<const Bytef*>(checked.data()),
                      static_cast<uInt>(checked.size())))
        << kind;
    if (kind == "IHDR") {
      EXPECT_EQ(u32_at(body, 0), 16U);
      EXPECT_EQ(u32_at(body, 4), 16U);
      EXPECT_EQ(body.substr(8), std::string("\x08\x03\x00\x00\x00", 5));
    }
    palette = kind == "PLTE" ? body : palette;
    packed = kind == "IDAT" ? body : packed;
    at += 12 + size;
  }
  EXPECT_EQ(palette.size(), std::size_t{3} * 256);
  EXPECT_EQ(palette.substr(std::size_t{3} * 255), "\xff\x20\x20");
  std::string lines(std::size_t{16} * 17, '\0');
  uLongf size = lines.size();
  ASSERT_EQ(::uncompress(reinterpret_cast<Bytef*>(lines.data()), &size,
                         reinterpret_cast<const Bytef*>(packed.data()),
                         static_cast<uLong>(packed.size())),
            Z_OK);
  ASSERT_EQ(size, lines.size());
  for (std::size_t i = 0; i < 256; ++i) {
    EXPECT_EQ(static_cast<unsigned char>(lines[i / 16 * 17 + 1 + i % 16]), i);
  }
}

}  // namespace
}  // namespace haarlight::capture
