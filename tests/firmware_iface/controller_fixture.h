// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <initializer_list>
#include <vector>

#include "firmware_iface/light_controller.h"
#include "firmware_iface/register_codec.h"
#include "haarlight/firmware_iface/register_map.h"

/// @file
/// A small controller and the words that tests write to it.

namespace haarlight::firmware_iface {

inline constexpr std::int64_t kMs = 1'000'000;

/// Two strings of 8 elements of 5 W; each string may draw 20 W, both together 30 W.
inline ControllerConfig small_config() {
  ControllerConfig config;
  config.groups = {{0, 8, Watts(5.0), Watts(20.0)}, {8, 8, Watts(5.0), Watts(20.0)}};
  config.max_power = Watts(30.0);
  config.table_depth = 8;
  config.default_lease = std::chrono::milliseconds(1000);
  return config;
}

/// n elements without effective limits.
inline ControllerConfig wide_config(int n) {
  ControllerConfig config;
  config.groups = {{0, n, Watts(5.0), Watts(5.0 * n)}};
  config.max_power = Watts(5.0 * n);
  config.table_depth = 1024;
  return config;
}

inline registers::Exception write_words(LightController& controller, std::uint16_t first,
                                        std::initializer_list<std::uint16_t> words,
                                        std::int64_t t_ns) {
  const std::vector<std::uint16_t> copy(words);
  return controller.write_holding(first, copy, t_ns);
}

inline registers::Exception set_level(LightController& controller, int element,
                                      std::uint16_t level, std::int64_t t_ns) {
  return write_words(controller,
                     static_cast<std::uint16_t>(registers::holding::kLevels + element), {level},
                     t_ns);
}

inline registers::Exception set_on(LightController& controller, int element, bool is_on,
                                   std::int64_t t_ns) {
  const std::array<bool, 1> bit = {is_on};
  return controller.write_coils(static_cast<std::uint16_t>(element), bit, t_ns);
}

/// Tag and latch, without a bank sum.
inline registers::Exception latch(LightController& controller, std::uint32_t tag,
                                  std::int64_t t_ns) {
  if (const auto no = write_words(controller, registers::holding::kTag,
                                  {high_word(tag), low_word(tag)}, t_ns);
      no != registers::Exception::none) {
    return no;
  }
  return write_words(controller, registers::holding::kLatch, {registers::kAct}, t_ns);
}

inline registers::Exception all_off(LightController& controller, std::int64_t t_ns) {
  return write_words(controller, registers::holding::kAllOff, {registers::kAct}, t_ns);
}

inline StatusBlock status_of(LightController& controller, std::int64_t t_ns) {
  std::array<std::uint16_t, registers::input::kStatusCount> words{};
  const auto no = controller.read_input(registers::input::kStatusFirst, words, t_ns);
  const auto block = decode_status(words);
  if (no != registers::Exception::none || !block) {
    throw ContractViolation("the status of a controller is always readable");
  }
  return *block;
}

}  // namespace haarlight::firmware_iface
