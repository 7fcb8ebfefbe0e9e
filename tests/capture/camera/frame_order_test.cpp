// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/frame_order.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

namespace haarlight::capture {
namespace {

constexpr std::int64_t kPatienceNs = 10'000'000'000;
constexpr std::int64_t kFrameNs = 33'000'000;

TEST(FrameOrder, CountsOnOverTheWrapOf32Bits) {
  FrameOrder order(kPatienceNs);
  std::int64_t t = 1'000'000'000'000;
  std::uint64_t last = 0;
  for (const std::uint32_t raw : {0xFFFF'FFFEU, 0xFFFF'FFFFU, 0U, 1U}) {
    t += kFrameNs;
    const FrameOrder::Verdict verdict = order.classify(raw, t, t);
    EXPECT_FALSE(verdict.is_restart) << raw;
    EXPECT_TRUE(last == 0 || verdict.sequence == last + 1) << raw;
    last = verdict.sequence;
  }
  EXPECT_EQ(last, 0x1'0000'0001U);
}

TEST(FrameOrder, AGapKeepsItsLength) {
  FrameOrder order(kPatienceNs);
  EXPECT_EQ(order.classify(7, 1, 1).sequence, 7U);
  EXPECT_EQ(order.classify(12, 2, 2).sequence, 12U);
}

TEST(FrameOrder, ACountThatGoesBackOrStandsIsToldOnceAndLeavesAGap) {
  FrameOrder order(kPatienceNs);
  (void)order.classify(100, 1, 1);
  for (const std::uint32_t raw : {100U, 3U}) {
    const std::uint64_t before = order.classify(raw, 2, 2).sequence;
    const FrameOrder::Verdict next = order.classify(raw + 1, 3, 3);
    EXPECT_FALSE(next.is_restart);
    EXPECT_EQ(next.sequence, before + 1);
  }
}

TEST(FrameOrder, AStreamBegunAnewContinuesAfterAGapWithoutAComplaint) {
  FrameOrder order(kPatienceNs);
  (void)order.classify(41, 1, 1);
  order.restart();
  const FrameOrder::Verdict verdict = order.classify(0, 2, 2);
  EXPECT_FALSE(verdict.is_restart);
  EXPECT_EQ(verdict.sequence, 43U);
  EXPECT_EQ(order.classify(1, 3, 3).sequence, 44U);
}

TEST(FrameOrder, ATimestampOfThePastTheFutureOrLongAgoIsAJumpAndIsForgotten) {
  FrameOrder order(kPatienceNs);
  const std::int64_t t = 1'000'000'000'000;
  EXPECT_FALSE(order.classify(0, t, t + 1).is_timestamp_jump);
  EXPECT_TRUE(order.classify(1, t, t + kFrameNs).is_timestamp_jump);      // the same again
  EXPECT_TRUE(order.classify(2, t - 1, t + kFrameNs).is_timestamp_jump);  // back
  EXPECT_TRUE(order.classify(3, t + 1'000'000'000, t + kFrameNs).is_timestamp_jump);
  EXPECT_TRUE(order.classify(4, t + 1, t + kPatienceNs + 2).is_timestamp_jump);
  EXPECT_FALSE(order.classify(5, t + kFrameNs, t + kFrameNs).is_timestamp_jump);
}

TEST(FrameOrder, ATimestampIsNeverLaterThanItsFramesArrival) {
  const std::int64_t t = 1'000'000'000'000;
  EXPECT_FALSE(FrameOrder(kPatienceNs).classify(0, t, t).is_timestamp_jump);
  EXPECT_TRUE(FrameOrder(kPatienceNs).classify(0, t + 1, t).is_timestamp_jump);
}

RC_GTEST_PROP(FrameOrder, SequencesGrowAndTellEveryGapWhateverTheDriverCounts,
              (std::uint32_t first)) {
  const auto steps = *rc::gen::container<std::vector<std::uint32_t>>(rc::gen::oneOf(
      rc::gen::inRange<std::uint32_t>(1, 5), rc::gen::arbitrary<std::uint32_t>()));
  FrameOrder order(kPatienceNs);
  std::uint32_t raw = first;
  std::int64_t t = kPatienceNs;
  std::uint64_t last = order.classify(raw, t, t).sequence;
  for (const std::uint32_t step : steps) {
    raw += step;
    t += kFrameNs;
    const FrameOrder::Verdict verdict = order.classify(raw, t, t);
    RC_ASSERT(verdict.sequence > last);
    const bool is_forward = step > 0 && step < 0x8000'0000U;
    RC_ASSERT(verdict.is_restart == !is_forward);
    RC_ASSERT(verdict.sequence - last == (is_forward ? step : 2U));
    RC_ASSERT(!verdict.is_timestamp_jump);
    last = verdict.sequence;
  }
}

}  // namespace
}  // namespace haarlight::capture
