// SPDX-License-Identifier: Apache-2.0
#include "capture/sequencer/strobe_proof.h"

#include <gtest/gtest.h>

namespace haarlight::capture {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kUs = 1'000;

/// 100 fps, E = 4 ms: frame n is exposed from 10 n + 6 ms to 10 n + 10 ms; strobe n at its end.
constexpr StrobeTiming kTiming{.period_ns = 10 * kMs, .settle_ns = 500 * kUs, .guard_ns = kMs};

session::ExposureWindow frame(int n) { return {(10 * n + 6) * kMs, (10 * n + 10) * kMs}; }

StepReading reading(double t_ms, std::uint32_t counter) {
  const auto t_ns = static_cast<std::int64_t>(t_ms * 1e6);
  return {.t_request_ns = t_ns,
          .t_ack_ns = t_ns + 100 * kUs,
          .counter = counter,
          .tag = 100 + counter};
}

TEST(StrobeProof, OneStepBetweenReadingsBeforeAndAfterProvesTheFrame) {
  const StrobeProof proof =
      prove_by_strobe({reading(2, 7), reading(8, 7), reading(12, 8)}, frame(0), kTiming);
  EXPECT_EQ(proof.verdict, StrobeVerdict::proven);
  EXPECT_EQ(proof.counter, 7U);
  EXPECT_EQ(proof.tag, 107U);
  EXPECT_EQ(proof.t_stable_ns, 500 * kUs);
}

TEST(StrobeProof, WaitsForTheFrameAfter) {
  EXPECT_EQ(prove_by_strobe({reading(2, 7), reading(8, 7)}, frame(0), kTiming).verdict,
            StrobeVerdict::wait);
  // Next to the strobe a reading says nothing.
  EXPECT_EQ(prove_by_strobe({reading(2, 7), reading(8, 7), reading(10.5, 8)}, frame(0), kTiming)
                .verdict,
            StrobeVerdict::wait);
}

TEST(StrobeProof, TheFrameBeforeStandsInForAnEarlyReading) {
  const std::deque<StepReading> late = {reading(7, 7), reading(12, 8)};
  EXPECT_EQ(prove_by_strobe(late, frame(0), kTiming).verdict, StrobeVerdict::unproven)
      << "when the light became what it is, nobody saw";
  std::deque<StepReading> with_before = late;
  with_before.push_front(reading(-5, 6));
  EXPECT_EQ(prove_by_strobe(with_before, frame(0), kTiming).verdict, StrobeVerdict::proven);
  with_before.front().counter = 7;  // the step came too late, or not at the strobe
  EXPECT_EQ(prove_by_strobe(with_before, frame(0), kTiming).verdict, StrobeVerdict::unproven);
}

TEST(StrobeProof, ALostStrobeVoidsTheFrame) {
  EXPECT_EQ(prove_by_strobe({reading(2, 7), reading(8, 7), reading(12, 7)}, frame(0), kTiming)
                .verdict,
            StrobeVerdict::unproven);
}

TEST(StrobeProof, AFalseEdgeWithinTheFrameVoidsIt) {
  EXPECT_EQ(prove_by_strobe({reading(2, 7), reading(8, 8), reading(12, 9)}, frame(0), kTiming)
                .verdict,
            StrobeVerdict::unproven);
  EXPECT_EQ(prove_by_strobe({reading(2, 7), reading(8, 7), reading(12, 9)}, frame(0), kTiming)
                .verdict,
            StrobeVerdict::unproven);
}

TEST(StrobeProof, AMissedReadingVoidsTheFrame) {
  EXPECT_EQ(prove_by_strobe({reading(2, 7), reading(8, 7), reading(22, 9)}, frame(0), kTiming)
                .verdict,
            StrobeVerdict::unproven);
}

TEST(StrobeProof, ALightThatSettlesWithinTheExposureVoidsIt) {
  StrobeTiming slow = kTiming;
  slow.settle_ns = 7 * kMs;
  EXPECT_EQ(prove_by_strobe({reading(-5, 6), reading(2, 7), reading(8, 7), reading(12, 8)},
                            frame(0), slow)
                .verdict,
            StrobeVerdict::unproven);
}

TEST(StrobeProof, EverySecondStrobeProvesTheSecondFrameAlone) {
  StrobeTiming second = kTiming;
  second.every = 2;
  // Steps at -10 (to 7), 10 (to 8) and 30 ms (to 9).
  const std::deque<StepReading> readings = {reading(-12, 6), reading(-5, 7), reading(5, 7),
                                            reading(15, 8),  reading(25, 8), reading(35, 9)};
  const StrobeProof proof = prove_by_strobe(readings, frame(0), second);
  EXPECT_EQ(proof.verdict, StrobeVerdict::proven);
  EXPECT_EQ(proof.counter, 7U);
  EXPECT_EQ(prove_by_strobe(readings, frame(1), second).verdict, StrobeVerdict::unproven);
}

TEST(StrobeProof, ALightIsShownBeforeItsExposureAtEverySecondStrobeToo) {
  StrobeTiming second = kTiming;
  second.every = 2;
  // A rolling shutter: exposed from -6 to 10 ms, lit at -10 ms.
  const session::ExposureWindow rolling{-6 * kMs, 10 * kMs};
  const std::deque<StepReading> rest = {reading(-2, 7), reading(5, 7), reading(15, 8),
                                        reading(25, 8)};
  const auto with = [&rest](StepReading first) {
    std::deque<StepReading> all = rest;
    all.push_front(first);
    return all;
  };
  const StrobeProof seen = prove_by_strobe(with(reading(-8, 7)), rolling, second);
  EXPECT_EQ(seen.verdict, StrobeVerdict::proven);
  EXPECT_EQ(seen.t_shown_ns, -8 * kMs + 100 * kUs);
  // None fits between -9 and -6.5 ms: the frame before says that it stepped there.
  const StrobeProof between = prove_by_strobe(with(reading(-12, 6)), rolling, second);
  EXPECT_EQ(between.verdict, StrobeVerdict::proven);
  EXPECT_EQ(between.t_shown_ns, std::nullopt) << "not a reading amid the exposure";
  EXPECT_EQ(prove_by_strobe(with(reading(-12, 7)), rolling, second).verdict,
            StrobeVerdict::unproven);
  EXPECT_EQ(prove_by_strobe(rest, rolling, second).verdict, StrobeVerdict::unproven);
  EXPECT_EQ(prove_by_strobe(with(reading(-8, 6)), rolling, second).verdict,
            StrobeVerdict::unproven)
      << "the step came late";
}

TEST(StrobeProof, AFalseEdgeThatShiftsTheBeatVoidsTheFrame) {
  StrobeTiming second = kTiming;
  second.every = 2;
  // An edge from nowhere at 9 ms steps to 8; the next step comes at 20 instead of 30 ms.
  EXPECT_EQ(prove_by_strobe({reading(-12, 6), reading(-5, 7), reading(5, 7), reading(15, 8),
                             reading(25, 9), reading(35, 9)},
                            frame(0), second)
                .verdict,
            StrobeVerdict::unproven);
}

}  // namespace
}  // namespace haarlight::capture
