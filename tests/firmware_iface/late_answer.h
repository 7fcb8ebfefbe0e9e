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

/// One read is answered after `delay`, longer than the bus's turnaround: it times out, nothing
/// passes until the line has settled, and the read after that gets its own answer.
inline void expect_late_answer_is_not_the_next(firmware_iface::RegisterBus& bus,
                                               sim::ControllerServer& server,
                                               std::chrono::milliseconds delay) {
  ASSERT_TRUE(bus.open());
  const std::vector<std::uint16_t> levels = {111, 222};
  ASSERT_TRUE(bus.write_holding(firmware_iface::registers::holding::kLevels, levels));
  server.inject({.kind = sim::WireFault::delay_reply, .delay = delay});
  std::array<std::uint16_t, 1> word{};
  const auto late = bus.read_holding(firmware_iface::registers::holding::kLevels, word);
  ASSERT_FALSE(late);
  EXPECT_EQ(late.error().code, Errc::timeout);
  const auto refused = bus.read_holding(firmware_iface::registers::holding::kLevels + 1, word);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::protocol);
  ASSERT_TRUE(bus.settle());
  const auto answer = bus.read_holding(firmware_iface::registers::holding::kLevels + 1, word);
  ASSERT_TRUE(answer) << answer.error().what;
  EXPECT_EQ(word[0], 222);
}

}  // namespace haarlight::testing
