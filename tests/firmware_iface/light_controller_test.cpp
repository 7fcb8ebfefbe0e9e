// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/light_controller.h"

#include <array>
#include <chrono>
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/firmware_iface/controller_fixture.h"

namespace haarlight::firmware_iface {
namespace {

using registers::Exception;
using registers::Refusal;
namespace hold = registers::holding;

constexpr std::uint16_t kFull = 65535;

TEST(LightController, StartsDarkWithTagZero) {
  LightController c(small_config(), 7, 0);
  EXPECT_TRUE(c.lit().pattern->empty());
  const StatusBlock block = status_of(c, 1 * kMs);
  EXPECT_TRUE(block.status.is_dark);
  EXPECT_EQ(block.status.tag, 0U);
  EXPECT_EQ(block.status.boot_id, 7U);
  EXPECT_EQ(block.status.uptime_ms, 1U);
  EXPECT_EQ(c.next_deadline_ns(), std::numeric_limits<std::int64_t>::max());
}

TEST(LightController, ShowsNothingBeforeTheLatch) {
  LightController c(small_config(), 1, 0);
  ASSERT_EQ(set_level(c, 3, kFull, 0), Exception::none);
  ASSERT_EQ(set_on(c, 3, true, 0), Exception::none);
  EXPECT_TRUE(c.lit().pattern->empty());
  ASSERT_EQ(latch(c, 42, 5 * kMs), Exception::none);
  EXPECT_EQ(c.lit().level(3), kFull);
  EXPECT_EQ(c.lit().tag, 42U);
  EXPECT_EQ(c.lit().t_ns, 5 * kMs);
  const StatusBlock block = status_of(c, 6 * kMs);
  EXPECT_EQ(block.status.tag, 42U);
  EXPECT_EQ(block.shown_sum, bank_sum_term(3, kFull));
  // 5 W at 48 V, rounded to 0.01 A.
  EXPECT_NEAR(block.status.supply_a, 5.0 / 48.0, 0.005);
}

TEST(LightController, RefusesALatchWithAnotherBankSumAndIsDark) {
  LightController c(small_config(), 1, 0);
  ASSERT_EQ(set_level(c, 0, kFull, 0), Exception::none);
  ASSERT_EQ(set_on(c, 0, true, 0), Exception::none);
  ASSERT_EQ(latch(c, 1, 0), Exception::none);
  EXPECT_EQ(write_words(c, hold::kTag, {0, 2, 0x1234, 0x5678, registers::kAct}, kMs),
            Exception::bank_sum);
  EXPECT_TRUE(c.lit().pattern->empty());
  EXPECT_EQ(status_of(c, kMs).refusal, Refusal::bank_sum);
  const std::uint32_t sum = bank_sum_term(0, kFull);
  EXPECT_EQ(write_words(c, hold::kTag, {0, 2, high_word(sum), low_word(sum), registers::kAct},
                        2 * kMs),
            Exception::none);
  EXPECT_EQ(c.lit().tag, 2U);
}

TEST(LightController, RefusesLightUnderTagZero) {
  LightController c(small_config(), 1, 0);
  ASSERT_EQ(set_level(c, 0, 1, 0), Exception::none);
  ASSERT_EQ(set_on(c, 0, true, 0), Exception::none);
  EXPECT_EQ(latch(c, 0, 0), Exception::device_failure);
  EXPECT_EQ(status_of(c, 0).refusal, Refusal::tag_zero);
}

TEST(LightController, HoldsTheTotalAndTheGroupLimitToTheLastLevel) {
  LightController c(small_config(), 1, 0);
  // Six elements at full drive are 30 W, the total limit; four of them on one string its 20 W.
  for (const int k : {0, 1, 2, 3, 8, 9}) {
    ASSERT_EQ(set_level(c, k, kFull, 0), Exception::none);
    ASSERT_EQ(set_on(c, k, true, 0), Exception::none);
  }
  EXPECT_EQ(latch(c, 1, 0), Exception::none);
  EXPECT_DOUBLE_EQ(c.power().value(), 30.0);
  ASSERT_EQ(set_level(c, 10, 1, 0), Exception::none);  // 76 microwatts more
  ASSERT_EQ(set_on(c, 10, true, 0), Exception::none);
  EXPECT_EQ(latch(c, 2, 0), Exception::device_failure);
  EXPECT_TRUE(c.lit().pattern->empty());
  EXPECT_EQ(status_of(c, 0).refusal, Refusal::total_power);
  EXPECT_NE(c.faults() & registers::kFaultOverPower, 0U);
  for (const int k : {8, 9, 10}) {
    ASSERT_EQ(set_on(c, k, false, 0), Exception::none);
  }
  ASSERT_EQ(set_level(c, 4, 1, 0), Exception::none);
  ASSERT_EQ(set_on(c, 4, true, 0), Exception::none);
  EXPECT_EQ(latch(c, 3, 0), Exception::device_failure);
  EXPECT_EQ(status_of(c, 0).refusal, Refusal::group_power);
}

TEST(LightController, LoweredPowerLimitCutsWhatIsLit) {
  LightController c(small_config(), 1, 0);
  ASSERT_EQ(set_level(c, 0, kFull, 0), Exception::none);
  ASSERT_EQ(set_on(c, 0, true, 0), Exception::none);
  ASSERT_EQ(latch(c, 1, 0), Exception::none);
  EXPECT_EQ(write_words(c, hold::kPowerLimit, {0, 301}, kMs), Exception::illegal_value);
  EXPECT_EQ(write_words(c, hold::kPowerLimit, {0, 49}, kMs), Exception::none);
  EXPECT_TRUE(c.lit().pattern->empty());
}

TEST(LightController, LeaseExpiresAtItsOwnMomentHoweverLateOneLooks) {
  LightController c(small_config(), 1, 0);
  ASSERT_EQ(set_level(c, 0, kFull, 0), Exception::none);
  ASSERT_EQ(set_on(c, 0, true, 0), Exception::none);
  ASSERT_EQ(latch(c, 1, 100 * kMs), Exception::none);
  EXPECT_EQ(c.next_deadline_ns(), 1100 * kMs);
  ASSERT_EQ(write_words(c, hold::kLeaseRenew, {1}, 600 * kMs), Exception::none);
  c.advance(60'000 * kMs);
  EXPECT_EQ(c.lit().t_ns, 1600 * kMs);
  EXPECT_TRUE(c.lit().pattern->empty());
  EXPECT_DOUBLE_EQ(c.total_on_seconds(0), 1.5);
  const StatusBlock block = status_of(c, 60'000 * kMs);
  EXPECT_NE(block.status.faults & registers::kFaultLeaseExpired, 0U);
  EXPECT_EQ(block.status.tag, 0U);
  // The on bits went with it: a latch without writing again would show nothing.
  EXPECT_EQ(block.shadow_sum, 0U);
}

TEST(LightController, StrobeStepsAnArmedTableAndDoesNotRenewTheLease) {
  LightController c(small_config(), 1, 0);
  for (int k = 0; k < 3; ++k) {
    ASSERT_EQ(set_level(c, k, kFull, 0), Exception::none);
    ASSERT_EQ(set_on(c, k, true, 0), Exception::none);
    ASSERT_EQ(write_words(c, hold::kTag, {0, static_cast<std::uint16_t>(10 + k)}, 0),
              Exception::none);
    ASSERT_EQ(write_words(c, hold::kTableStore, {static_cast<std::uint16_t>(k)}, 0),
              Exception::none);
    ASSERT_EQ(set_on(c, k, false, 0), Exception::none);
  }
  ASSERT_EQ(write_words(c, hold::kStepSource, {1, 3}, 0), Exception::none);
  EXPECT_TRUE(c.lit().pattern->empty());
  for (int k = 0; k < 3; ++k) {
    c.strobe((100 + k) * kMs);
    EXPECT_EQ(c.lit().tag, 10U + static_cast<unsigned>(k));
    EXPECT_EQ(c.lit().level(k), kFull);
    EXPECT_EQ(c.lit().pattern->size(), 1U);
  }
  c.strobe(200 * kMs);
  EXPECT_TRUE(c.lit().pattern->empty());
  EXPECT_EQ(status_of(c, 200 * kMs).status.step_counter, 4U);
  // Armed at 0 with a lease of 1000 ms: disarmed then, strobes or not.
  ASSERT_EQ(write_words(c, hold::kTableArm, {3}, 300 * kMs), Exception::none);
  c.strobe(1200 * kMs);
  EXPECT_EQ(c.lit().tag, 10U);
  c.strobe(1301 * kMs);
  EXPECT_TRUE(c.lit().pattern->empty());
  EXPECT_EQ(c.lit().t_ns, 1300 * kMs);
}

TEST(LightController, StrobeDoesNothingWhileTheHostSteps) {
  LightController c(small_config(), 1, 0);
  ASSERT_EQ(write_words(c, hold::kTableStore, {0}, 0), Exception::none);
  ASSERT_EQ(write_words(c, hold::kStepSource, {0, 1}, 0), Exception::none);
  c.strobe(kMs);
  EXPECT_EQ(status_of(c, kMs).status.step_counter, 0U);
  EXPECT_EQ(write_words(c, hold::kStep, {1}, kMs), Exception::none);
  EXPECT_EQ(status_of(c, kMs).status.step_counter, 1U);
}

/// Entries 0 .. n-1 light element i under tag 10 + i.
void store_entries(LightController& c, int n) {
  for (int i = 0; i < n; ++i) {
    ASSERT_EQ(set_level(c, i, kFull, 0), Exception::none);
    ASSERT_EQ(set_on(c, i, true, 0), Exception::none);
    const auto index = static_cast<std::uint16_t>(i);
    const auto tag = static_cast<std::uint16_t>(10 + i);
    ASSERT_EQ(write_words(c, hold::kTag, {0, tag}, 0), Exception::none);
    ASSERT_EQ(write_words(c, hold::kTableStore, {index}, 0), Exception::none);
    ASSERT_EQ(set_on(c, i, false, 0), Exception::none);
  }
}

TEST(LightController, ATableIsExtendedWhileItRunsWithoutGoingDark) {
  LightController c(small_config(), 1, 0);
  store_entries(c, 4);
  ASSERT_EQ(write_words(c, hold::kStrobeDivider, {1, 1, 1, 2}, 0), Exception::none);
  c.strobe(1 * kMs);
  EXPECT_EQ(c.lit().tag, 11U) << "table_first = 1";
  c.strobe(2 * kMs);
  EXPECT_EQ(c.lit().tag, 12U);
  EXPECT_EQ(write_words(c, hold::kTableExtend, {1}, 2 * kMs), Exception::none) << "not more";
  EXPECT_EQ(write_words(c, hold::kTableExtend, {3}, 2 * kMs), Exception::none);
  EXPECT_EQ(c.lit().tag, 12U);
  c.strobe(3 * kMs);
  EXPECT_EQ(c.lit().tag, 13U);
  EXPECT_EQ(status_of(c, 3 * kMs).status.step_counter, 3U);
  EXPECT_FALSE(status_of(c, 3 * kMs).status.is_table_done);
}

TEST(LightController, ATablePastItsEndStaysDarkHoweverItIsExtended) {
  LightController c(small_config(), 1, 0);
  store_entries(c, 4);
  ASSERT_EQ(write_words(c, hold::kStrobeDivider, {1, 0, 1, 1}, 0), Exception::none);
  c.strobe(1 * kMs);
  c.strobe(2 * kMs);
  ASSERT_TRUE(status_of(c, 2 * kMs).status.is_table_done);
  EXPECT_EQ(write_words(c, hold::kTableExtend, {4}, 2 * kMs), Exception::none);
  c.strobe(3 * kMs);
  EXPECT_TRUE(c.lit().pattern->empty());
  EXPECT_EQ(c.lit().tag, 0U);
  // Armed again behind the last entry shown, nothing is uploaded.
  ASSERT_EQ(write_words(c, hold::kStrobeDivider, {1, 1, 1, 3}, 4 * kMs), Exception::none);
  c.strobe(5 * kMs);
  EXPECT_EQ(c.lit().tag, 11U);
  // Used once: the next arming begins at entry 0.
  ASSERT_EQ(write_words(c, hold::kStepSource, {1, 3}, 6 * kMs), Exception::none);
  c.strobe(7 * kMs);
  EXPECT_EQ(c.lit().tag, 10U);
}

TEST(LightController, ADividerOfTwoStepsAtEverySecondStrobe) {
  LightController c(small_config(), 1, 0);
  store_entries(c, 2);
  ASSERT_EQ(write_words(c, hold::kStrobeDivider, {2, 0, 1, 2}, 0), Exception::none);
  std::vector<std::uint32_t> tags;
  for (int i = 1; i <= 5; ++i) {
    c.strobe(i * kMs);
    tags.push_back(c.lit().tag);
  }
  EXPECT_THAT(tags, ::testing::ElementsAre(10, 10, 11, 11, 0));
  EXPECT_EQ(write_words(c, hold::kStrobeDivider, {0}, 0), Exception::illegal_value);
}

TEST(LightController, APulseFollowsEachLatchWhenATriggerDelayIsSet) {
  LightController c(small_config(), 1, 0);
  ASSERT_EQ(latch(c, 1, kMs), Exception::none);
  EXPECT_EQ(c.n_triggers(), 0U);
  ASSERT_EQ(write_words(c, hold::kTriggerDelay, {0, 500}, kMs), Exception::none);
  ASSERT_EQ(latch(c, 2, 3 * kMs), Exception::none);
  EXPECT_EQ(c.n_triggers(), 1U);
  EXPECT_EQ(c.last_trigger_ns(), 3 * kMs + 500'000);
  EXPECT_EQ(write_words(c, hold::kTriggerDelay, {0xFFFF, 0}, kMs), Exception::illegal_value);
}

TEST(LightController, RefusesToArmEntriesThatWereNeverStored) {
  LightController c(small_config(), 1, 0);
  EXPECT_EQ(write_words(c, hold::kTableArm, {1}, 0), Exception::device_failure);
  EXPECT_EQ(write_words(c, hold::kTableArm, {9}, 0), Exception::device_failure);
  EXPECT_EQ(write_words(c, hold::kStep, {1}, 0), Exception::device_failure);
  EXPECT_EQ(status_of(c, 0).refusal, Refusal::table_not_armed);
}

// h = 1 - exp(-t/tau) reaches 1/2 after tau ln 2.
TEST(LightController, CutsAnElementAtItsThermalDuty) {
  ControllerConfig config = small_config();
  config.duty_limit = 0.5;
  config.heat_tau = std::chrono::milliseconds(100);
  LightController c(config, 1, 0);
  ASSERT_EQ(set_level(c, 0, kFull, 0), Exception::none);
  ASSERT_EQ(set_on(c, 0, true, 0), Exception::none);
  ASSERT_EQ(latch(c, 1, 0), Exception::none);
  c.advance(500 * kMs);
  EXPECT_TRUE(c.lit().pattern->empty());
  EXPECT_NEAR(static_cast<double>(c.lit().t_ns), 100e6 * std::log(2.0), 2.0);
  ASSERT_EQ(set_on(c, 0, true, 500 * kMs), Exception::none);
  EXPECT_EQ(latch(c, 2, 500 * kMs), Exception::none);  // cooled to exp(-4.3) / 2
}

TEST(LightController, RefusesAnElementThatIsStillHot) {
  ControllerConfig config = small_config();
  config.duty_limit = 0.5;
  config.heat_tau = std::chrono::milliseconds(100);
  LightController c(config, 1, 0);
  ASSERT_EQ(set_level(c, 0, kFull, 0), Exception::none);
  ASSERT_EQ(set_on(c, 0, true, 0), Exception::none);
  ASSERT_EQ(latch(c, 1, 0), Exception::none);
  const std::int64_t cut = c.next_deadline_ns();
  c.advance(cut);
  ASSERT_TRUE(c.lit().pattern->empty());
  ASSERT_EQ(set_on(c, 0, true, cut), Exception::none);
  EXPECT_EQ(latch(c, 2, cut), Exception::device_failure);
  EXPECT_EQ(status_of(c, cut).refusal, Refusal::element_duty);
}

TEST(LightController, InterlockAndHeatBlockUntilTheyEnd) {
  LightController c(small_config(), 1, 0);
  ASSERT_EQ(set_level(c, 0, kFull, 0), Exception::none);
  ASSERT_EQ(set_on(c, 0, true, 0), Exception::none);
  ASSERT_EQ(latch(c, 1, 0), Exception::none);
  c.set_interlock_open(true, kMs);
  EXPECT_TRUE(c.lit().pattern->empty());
  ASSERT_EQ(set_on(c, 0, true, kMs), Exception::none);
  EXPECT_EQ(latch(c, 2, kMs), Exception::device_failure);
  ASSERT_EQ(write_words(c, hold::kFaultClear, {0xFFFF, 0xFFFF}, kMs), Exception::none);
  EXPECT_EQ(c.faults(), std::uint32_t{registers::kFaultInterlock});
  c.set_interlock_open(false, 2 * kMs);
  ASSERT_EQ(write_words(c, hold::kFaultClear, {0xFFFF, 0xFFFF}, 2 * kMs), Exception::none);
  EXPECT_EQ(c.faults(), 0U);
  EXPECT_EQ(latch(c, 3, 2 * kMs), Exception::none);
  c.set_temperature(90.0, 3 * kMs);
  EXPECT_TRUE(c.lit().pattern->empty());
  EXPECT_NEAR(status_of(c, 3 * kMs).status.temperature_c, 90.0, 1e-9);
}

TEST(LightController, RebootForgetsEverything) {
  LightController c(small_config(), 1, 0);
  ASSERT_EQ(set_level(c, 0, kFull, 0), Exception::none);
  ASSERT_EQ(set_on(c, 0, true, 0), Exception::none);
  ASSERT_EQ(latch(c, 1, 0), Exception::none);
  c.reboot(2, 10 * kMs);
  EXPECT_TRUE(c.lit().pattern->empty());
  const StatusBlock block = status_of(c, 12 * kMs);
  EXPECT_EQ(block.status.boot_id, 2U);
  EXPECT_EQ(block.status.uptime_ms, 2U);
  EXPECT_EQ(block.shadow_sum, 0U);
}

TEST(LightController, AddressesOutsideTheMapAreRefusedWhole) {
  LightController c(small_config(), 1, 0);
  EXPECT_EQ(write_words(c, hold::kLevels + 15, {1, 2}, 0), Exception::illegal_address);
  EXPECT_EQ(set_level(c, 16, 1, 0), Exception::illegal_address);
  EXPECT_EQ(write_words(c, 0x0006, {1}, 0), Exception::illegal_address);
  EXPECT_EQ(write_words(c, hold::kTag + 1, {1}, 0), Exception::illegal_address);
  EXPECT_EQ(write_words(c, hold::kTag, {1}, 0), Exception::illegal_address);
  std::array<std::uint16_t, 2> words{};
  EXPECT_EQ(c.read_holding(hold::kLevels + 14, words, 0), Exception::none);
  EXPECT_EQ(words[1], 0);  // level 15 was not written by the request that was refused
  EXPECT_EQ(c.read_input(0xFFFF, words, 0), Exception::illegal_address);
  EXPECT_EQ(c.read_input(0x0013, words, 0), Exception::illegal_address);
  std::array<bool, 17> bits{};
  EXPECT_EQ(c.read_coils(0, bits, 0), Exception::illegal_address);
}

TEST(LightController, TransitionsTellTheStateAtTheStartAndEachChange) {
  LightController c(small_config(), 1, 0);
  ASSERT_EQ(set_level(c, 0, 32768, 0), Exception::none);
  ASSERT_EQ(set_on(c, 0, true, 0), Exception::none);
  ASSERT_EQ(latch(c, 1, 10 * kMs), Exception::none);
  ASSERT_EQ(all_off(c, 20 * kMs), Exception::none);
  const LightHistory history = c.transitions(15 * kMs, 30 * kMs);
  ASSERT_EQ(history.states.size(), 2U);
  EXPECT_TRUE(history.is_complete);
  EXPECT_EQ(history.states[0].t_ns, 10 * kMs);
  EXPECT_EQ(history.states[1].t_ns, 20 * kMs);
  EXPECT_DOUBLE_EQ(on_seconds(history, 0, 15 * kMs, 30 * kMs), 0.005 * 32768.0 / 65535.0);
  EXPECT_DOUBLE_EQ(on_seconds(c.transitions(0, 30 * kMs), 0, 0, 30 * kMs),
                   c.total_on_seconds(0));
}

TEST(LightController, SaysWhenItsHistoryIsTooShort) {
  ControllerConfig config = small_config();
  config.history = 4;
  LightController c(config, 1, 0);
  for (int i = 1; i <= 10; ++i) {
    ASSERT_EQ(all_off(c, i * kMs), Exception::none);
  }
  EXPECT_FALSE(c.transitions(0, 10 * kMs).is_complete);
  EXPECT_TRUE(c.transitions(8 * kMs, 10 * kMs).is_complete);
}

// ---- acting late

/// A controller whose every command acts 20 ms after its acknowledgement.
LightController late_controller(LateActing::Shows shows) {
  LightController c(small_config(), 1, 0);
  c.set_late_acting({.fraction = 1.0,
                     .least = std::chrono::milliseconds(20),
                     .most = std::chrono::milliseconds(20),
                     .shows = shows});
  EXPECT_EQ(set_level(c, 0, 65535, 0), Exception::none);
  EXPECT_EQ(set_on(c, 0, true, 0), Exception::none);
  EXPECT_EQ(latch(c, 5, 10 * kMs), Exception::none);
  return c;
}

TEST(LightController, ALateOneThatIsHonestShowsTagAndSumWithItsLight) {
  LightController c = late_controller(LateActing::Shows::with_light);
  const std::array<ElementLevel, 1> pattern = {ElementLevel{0, 65535}};
  EXPECT_EQ(status_of(c, 29 * kMs).status.tag, 0U);
  EXPECT_EQ(status_of(c, 29 * kMs).shown_sum, 0U);
  EXPECT_TRUE(status_of(c, 29 * kMs).status.is_dark);
  EXPECT_EQ(status_of(c, 31 * kMs).status.tag, 5U);
  EXPECT_EQ(status_of(c, 31 * kMs).shown_sum, bank_sum(pattern));
  EXPECT_EQ(c.lit().t_ns, 30 * kMs);
}

TEST(LightController, ALateOneInOrderIsBusyUntilItsLight) {
  EXPECT_EQ(late_controller(LateActing::Shows::in_order).busy_until_ns(), 30 * kMs);
  EXPECT_EQ(late_controller(LateActing::Shows::with_light).busy_until_ns(), 10 * kMs);
}

TEST(LightController, ALateOneThatLiesShowsThemBeforeItsLight) {
  LightController c = late_controller(LateActing::Shows::at_once);
  EXPECT_EQ(status_of(c, 11 * kMs).status.tag, 5U);
  EXPECT_FALSE(status_of(c, 11 * kMs).status.is_dark);
  EXPECT_TRUE(c.lit().pattern->empty());
  c.advance(40 * kMs);
  EXPECT_EQ(c.lit().tag, 5U);
  EXPECT_EQ(c.lit().t_ns, 30 * kMs);
}

TEST(LightController, LateCommandsActInTheirOrderAndAPromptOneWaitsForThem) {
  LightController c = late_controller(LateActing::Shows::with_light);
  c.set_late_acting({});  // what comes now is prompt, but stands behind the latch
  ASSERT_EQ(all_off(c, 15 * kMs), Exception::none);
  c.advance(60 * kMs);
  const LightHistory history = c.transitions(12 * kMs, 60 * kMs);
  ASSERT_EQ(history.states.size(), 3U);
  EXPECT_EQ(history.states[1].tag, 5U);
  EXPECT_EQ(history.states[2].tag, 0U);
  EXPECT_EQ(history.states[2].t_ns, 30 * kMs);
}

TEST(LightController, WhatItDoesByItselfIsNeverLateAndEndsWhatWaits) {
  LightController c = late_controller(LateActing::Shows::with_light);
  c.set_interlock_open(true, 15 * kMs);
  c.advance(60 * kMs);
  EXPECT_TRUE(c.lit().pattern->empty());
  EXPECT_EQ(c.lit().t_ns, 15 * kMs);
}

TEST(LightController, ALateStepOfATableIsCountedWhenItShows) {
  LightController c = late_controller(LateActing::Shows::with_light);
  ASSERT_EQ(write_words(c, hold::kTableStore, {0}, 40 * kMs), Exception::none);
  ASSERT_EQ(write_words(c, hold::kStepSource, {0, 1}, 40 * kMs), Exception::none);
  ASSERT_EQ(write_words(c, hold::kStep, {registers::kAct}, 50 * kMs), Exception::none);
  EXPECT_EQ(status_of(c, 69 * kMs).status.step_counter, 0U);
  EXPECT_EQ(status_of(c, 71 * kMs).status.step_counter, 1U);
  EXPECT_EQ(c.lit().t_ns, 70 * kMs);
}

TEST(LightController, TheTriggerOfALateLatchFollowsItsLightUnlessItLies) {
  for (const auto shows : {LateActing::Shows::with_light, LateActing::Shows::at_once}) {
    LightController c = late_controller(shows);
    ASSERT_EQ(write_words(c, hold::kTriggerDelay, {0, 1000}, 40 * kMs), Exception::none);
    ASSERT_EQ(latch(c, 6, 50 * kMs), Exception::none);
    c.advance(80 * kMs);
    EXPECT_EQ(c.n_triggers(), 1U);
    EXPECT_EQ(c.last_trigger_ns(), shows == LateActing::Shows::at_once ? 51 * kMs : 71 * kMs);
  }
}

TEST(LightController, ClockThatStepsBackCountsAsStandingStill) {
  LightController c(small_config(), 1, 100 * kMs);
  ASSERT_EQ(all_off(c, 50 * kMs), Exception::none);
  EXPECT_EQ(c.lit().t_ns, 100 * kMs);
}

}  // namespace
}  // namespace haarlight::firmware_iface
