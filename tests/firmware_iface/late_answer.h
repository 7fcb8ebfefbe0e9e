// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <vector>

#include <gtest/gtest.h>

#include "firmware_iface/register_bus.h"
#include "haarlight/firmware_iface/register_map.h"
#include "sim/controller_server.h"

/// @file
/// The fault that other recovery takes for health: an answer later than its timeout, waiting to
/// be read as the next request's.

namespace haarlight::testing {

/// A call that has its answer, again where a busy machine gives it later than the turnaround; it
/// may fail in no other way.
template <class Call>
void expect_answered(firmware_iface::RegisterBus& bus, Call call) {
  for (int attempt = 0;; ++attempt) {
    ASSERT_LT(attempt, 20) << "no answer comes in time";
    if (!bus.settle() && !bus.open()) {
      continue;
    }
    const auto answer = call();
    if (answer) {
      return;
    }
    EXPECT_EQ(answer.error().code, Errc::timeout) << answer.error().what;
  }
}

/// One read of the register at kLevels, which holds `value`, is answered `delay` late: it times
/// out. A busy machine may put this thread off until the answer is there: then it is the right
/// one, and another one is delayed.
inline void time_out_on_a_late_answer(firmware_iface::RegisterBus& bus,
                                      sim::ControllerServer& server,
                                      std::chrono::milliseconds delay, std::uint16_t value) {
  std::array<std::uint16_t, 1> word{};
  for (int attempt = 0;; ++attempt) {
    ASSERT_LT(attempt, 20) << "no answer came late";
    server.inject({.kind = sim::WireFault::delay_reply, .delay = delay});
    const auto late = bus.read_holding(firmware_iface::registers::holding::kLevels, word);
    if (!late) {
      EXPECT_EQ(late.error().code, Errc::timeout);
      return;
    }
    EXPECT_EQ(word[0], value);
  }
}

/// One read is answered after `delay`, longer than the bus's turnaround: it times out, nothing
/// passes until the line has settled, and the reads after that get their own answers.
inline void expect_late_answer_is_not_the_next(firmware_iface::RegisterBus& bus,
                                               sim::ControllerServer& server,
                                               std::chrono::milliseconds delay) {
  namespace holding = firmware_iface::registers::holding;
  ASSERT_TRUE(bus.open());
  const std::vector<std::uint16_t> levels = {111, 222};
  expect_answered(bus, [&] { return bus.write_holding(holding::kLevels, levels); });
  time_out_on_a_late_answer(bus, server, delay, 111);
  std::array<std::uint16_t, 1> word{};
  const auto refused = bus.read_holding(holding::kLevels + 1, word);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::protocol);
  for (int i = 0; i < 3; ++i) {
    word[0] = 0;
    expect_answered(bus, [&] { return bus.read_holding(holding::kLevels + 1, word); });
    EXPECT_EQ(word[0], 222);
  }
}

}  // namespace haarlight::testing
