// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/evidence.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "haarlight/core/error.h"
#include "session/clean_rule.h"
#include "session/frame_tiff.h"

namespace haarlight::session {
namespace {

using testing::HasSubstr;

TEST(CleanRule, WindowFollowsFromTheMeaningOfTheTimestamp) {
  // E = 4000 us, t_read = 250 us, skew = 1000 us, timestamp at 10 ms.
  ExposureTiming timing{10'000'000, TimestampMeaning::start_exposure, 4000.0, 250.0, 1000.0};
  EXPECT_EQ(exposure_window(timing), (ExposureWindow{10'000'000, 15'000'000}));
  timing.meaning = TimestampMeaning::start_readout;
  EXPECT_EQ(exposure_window(timing), (ExposureWindow{6'000'000, 11'000'000}));
  timing.meaning = TimestampMeaning::end_frame;
  EXPECT_EQ(exposure_window(timing), (ExposureWindow{5'750'000, 10'750'000}));
}

TEST(CleanRule, BordersAreCleanAndOneNanosecondOutsideIsNot) {
  const ExposureWindow window{100, 200};
  EXPECT_TRUE(assess_clean(window, 100, 200).is_clean);
  EXPECT_EQ(assess_clean(window, 100, 200).margin_us, 0.0);
  EXPECT_FALSE(assess_clean(window, 101, 200).is_clean);
  EXPECT_FALSE(assess_clean(window, 100, 199).is_clean);
  EXPECT_DOUBLE_EQ(assess_clean(window, 101, 200).margin_us, -0.001);
  EXPECT_TRUE(assess_clean(window, 0, kNoNextChange).is_clean);
  EXPECT_DOUBLE_EQ(assess_clean(window, 0, kNoNextChange).margin_us, 0.1);
}

RC_GTEST_PROP(CleanRule, IsCleanExactlyWhenTheMarginIsNotNegative,
              (std::int32_t start, std::uint16_t length, std::int32_t stable,
               std::int32_t next)) {
  const ExposureWindow window{start, std::int64_t{start} + length};
  const CleanVerdict verdict = assess_clean(window, stable, next);
  RC_ASSERT(verdict.is_clean == (verdict.margin_us >= 0.0));
}

RC_GTEST_PROP(CleanRule, MovingAllTimesMovesNothing,
              (std::int32_t shift, std::uint32_t timestamp)) {
  const ExposureTiming timing{timestamp, TimestampMeaning::end_frame, 4000.5, 33.25, 7.125};
  ExposureTiming moved = timing;
  moved.timestamp_ns += shift;
  const ExposureWindow a = exposure_window(timing);
  const ExposureWindow b = exposure_window(moved);
  RC_ASSERT(b.start_ns - a.start_ns == shift);
  RC_ASSERT(b.end_ns - a.end_ns == shift);
}

TEST(CleanRule, CameraLeadsNeedsTheLightToSettleInsideThePeriod) {
  EXPECT_DOUBLE_EQ(camera_leads_margin_us(4000, 1000, 300, 200, 8333), 2833.0);
  EXPECT_LT(camera_leads_margin_us(4000, 1000, 300, 200, 5000), 0.0);
}

FrameEvidence good_evidence() {
  FrameEvidence e;
  e.pattern_id = 7;
  e.tag = e.tag_echo = 8;
  e.t_command_ns = 1;
  e.t_ack_ns = 2;
  e.t_shown_ns = 2;
  e.t_stable_ns = 3;
  e.timestamp_ns = 9'000'000'000'000'000'001;  // more digits than a double holds
  e.timestamp_meaning = TimestampMeaning::start_exposure;
  e.exposure_read_us = 0.1;
  e.t_exposure_start_ns = e.timestamp_ns;
  e.t_exposure_end_ns = e.timestamp_ns + 100;
  e.t_next_change_ns = kNoNextChange;
  e.mean_dn = 1.0 / 3.0;
  e.pixel_hash = "00";
  return e;
}

TEST(Evidence, SaysInWordsWhatDoesNotHold) {
  EXPECT_EQ(find_evidence_problem(good_evidence()), "");
  const auto problem_of = [](auto change) {
    FrameEvidence e = good_evidence();
    change(e);
    return find_evidence_problem(e);
  };
  EXPECT_NE(problem_of([](auto& e) { e.tag_echo = 9; }), "");
  EXPECT_NE(problem_of([](auto& e) { e.flags = 1; }), "");
  EXPECT_NE(problem_of([](auto& e) { e.pixel_hash.clear(); }), "");
  EXPECT_NE(problem_of([](auto& e) { e.t_exposure_end_ns += 1; }), "");
  EXPECT_NE(problem_of([](auto& e) { e.t_ack_ns = 0; }), "");
  EXPECT_NE(problem_of([](auto& e) { e.t_shown_ns = 1; }), "") << "read back before the answer";
  EXPECT_NE(problem_of([](auto& e) { e.t_shown_ns = 4; }), "") << "stable before it was shown";
  EXPECT_EQ(problem_of([](auto& e) { e.t_shown_ns = 3; }), "");
  EXPECT_NE(problem_of([](auto& e) { e.t_stable_ns = e.t_exposure_start_ns + 1; }), "");
  EXPECT_NE(problem_of([](auto& e) { e.t_next_change_ns = e.t_exposure_end_ns - 1; }), "");
  EXPECT_NE(problem_of([](auto& e) { e.sync = SyncMode::camera_leads; }), "");
  EXPECT_EQ(problem_of([](auto& e) {
              e.sync = SyncMode::camera_leads;
              e.step_before = 4;
              e.step_after = 5;
            }),
            "");
}

TEST(Evidence, ASessionWithoutTheReadBacksTimeIsValidatedByItsAcknowledgement) {
  std::string json = evidence_to_json(good_evidence());
  const std::string field = "\"t_shown_ns\":2,";
  ASSERT_NE(json.find(field), std::string::npos);
  json.erase(json.find(field), field.size());
  const FrameEvidence old = evidence_from_json(json, "x");
  EXPECT_FALSE(old.t_shown_ns.has_value());
  EXPECT_EQ(find_evidence_problem(old), "");
  FrameEvidence wrong = old;
  wrong.t_stable_ns = 1;
  EXPECT_NE(find_evidence_problem(wrong), "");
}

TEST(Evidence, AStepReadOutsideItsTimeDoesNotHold) {
  FrameEvidence e = good_evidence();
  e.sync = SyncMode::camera_leads;
  e.step_before = 4;
  e.step_after = 5;
  EXPECT_EQ(find_evidence_problem(e), "");
  e.t_shown_ns = e.t_exposure_start_ns + 1;
  EXPECT_NE(find_evidence_problem(e), "");
  e.t_shown_ns = std::nullopt;  // no reading fell before the exposure
  EXPECT_EQ(find_evidence_problem(e), "");
}

TEST(EvidenceJson, KeepsEveryBit) {
  const FrameEvidence e = good_evidence();
  EXPECT_EQ(evidence_from_json(evidence_to_json(e), "x"), e);
}

RC_GTEST_PROP(EvidenceJson, ReadsBackWhatItWrote,
              (std::uint64_t sequence, std::int64_t t, std::uint32_t tag, std::uint16_t dn)) {
  FrameEvidence e;
  e.sequence = sequence;
  e.t_command_ns = t;
  e.tag = tag;
  e.max_dn = dn;
  e.margin_us = static_cast<double>(t) / 7.0;
  e.sync = static_cast<SyncMode>(tag % 4);
  e.kind = static_cast<EvidenceKind>(tag % 3);
  RC_ASSERT(evidence_from_json(evidence_to_json(e), "x") == e);
}

TEST(EvidenceJson, NamesTheBrokenField) {
  const std::string good = evidence_to_json(good_evidence());
  const auto message_of = [](const std::string& json) -> std::string {
    try {
      (void)evidence_from_json(json, "frame.tif");
    } catch (const Error& error) {
      EXPECT_FALSE(error.hint().empty());
      return error.where() + " | " + error.problem();
    }
    return "accepted";
  };
  const auto replaced = [&good](const std::string& from, const std::string& to) {
    std::string json = good;
    const std::size_t at = json.find(from);
    EXPECT_NE(at, std::string::npos);
    return json.replace(at, from.size(), to);
  };
  EXPECT_THAT(message_of(replaced("\"tag\":8", "\"tag\":-8")), HasSubstr("frame.tif: tag | "));
  EXPECT_THAT(message_of(replaced("\"tag\"", "\"tug\"")), HasSubstr("\"tag\" is missing"));
  EXPECT_THAT(message_of(replaced("\"free-run\"", "\"freewheel\"")), HasSubstr("sync"));
  EXPECT_THAT(message_of(replaced("\"max_dn\":0", "\"max_dn\":70000")), HasSubstr("max_dn"));
  EXPECT_THAT(message_of(good.substr(0, 40)), HasSubstr("byte"));
  EXPECT_THAT(message_of("[]"), HasSubstr("object"));
}

TEST(FrameFileName, ReadsBackWhatItWrote) {
  int shot = 0;
  int attempt = 0;
  EXPECT_EQ(frame_file_name(12, 3), "frames/000012_a3.tif");
  EXPECT_TRUE(parse_frame_file_name("000012_a3.tif", shot, attempt));
  EXPECT_EQ(shot, 12);
  EXPECT_EQ(attempt, 3);
  for (const char* name : {"12_a3.tif", "000012_a3.tif.new1", "000012_a03.tif", "-00012_a3.tif",
                           "000012_a-3.tif", "frame.tif", "", "000012_a3.tiff"}) {
    EXPECT_FALSE(parse_frame_file_name(name, shot, attempt)) << name;
  }
}

}  // namespace
}  // namespace haarlight::session
