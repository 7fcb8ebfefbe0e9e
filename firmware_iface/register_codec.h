// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>

#include "haarlight/core/error.h"
#include "haarlight/firmware_iface/light_array.h"
#include "haarlight/firmware_iface/register_map.h"

/// @file
/// Converts between register words and values. Pure; safe from any thread.

namespace haarlight::firmware_iface {

[[nodiscard]] constexpr std::uint32_t join_words(std::uint16_t high, std::uint16_t low) {
  return (static_cast<std::uint32_t>(high) << 16U) | low;
}
[[nodiscard]] constexpr std::uint16_t high_word(std::uint32_t value) {
  return static_cast<std::uint16_t>(value >> 16U);
}
[[nodiscard]] constexpr std::uint16_t low_word(std::uint32_t value) {
  return static_cast<std::uint16_t>(value & 0xFFFFU);
}

/// One element's term of the bank sum; 0 for an element that is off.
/// A bijective 32-bit hash (xor-shift and two odd multipliers) of element and level, so that a
/// single wrong element or level always changes the sum. docs/reference/register-map.md
/// specifies it for firmware authors.
[[nodiscard]] constexpr std::uint32_t bank_sum_term(int element, std::uint16_t level) {
  if (level == 0) {
    return 0;
  }
  std::uint32_t x = (static_cast<std::uint32_t>(element) << 16U) | level;
  x ^= x >> 16U;
  x *= 0x7feb352dU;
  x ^= x >> 15U;
  x *= 0x846ca68bU;
  x ^= x >> 16U;
  return x;
}

/// Sum of the terms modulo 2^32: independent of order, updated by one addition per change.
/// @param pattern  each element at most once
[[nodiscard]] std::uint32_t bank_sum(std::span<const ElementLevel> pattern);

/// What the status block holds beyond ControllerStatus.
struct StatusBlock {
  ControllerStatus status;
  std::uint16_t bits = 0;  ///< registers::kStatus...
  std::uint32_t shown_sum = 0;
  std::uint32_t shadow_sum = 0;
  std::uint32_t latch_counter = 0;
  registers::Refusal refusal = registers::Refusal::none;
};

/// @param words  registers::input::kIdentityCount words from kMagic on
/// Fault protocol: not a light controller, or one with another map. boot_id and uptime stay 0.
[[nodiscard]] Result<ControllerIdentity> decode_identity(std::span<const std::uint16_t> words);

/// @param words  registers::input::kStatusCount words from kStatusFirst on
/// Fault protocol: wrong size, or bits that contradict each other (dark but drawing light).
[[nodiscard]] Result<StatusBlock> decode_status(std::span<const std::uint16_t> words);

[[nodiscard]] std::string_view reason_of(registers::Refusal refusal) noexcept;

}  // namespace haarlight::firmware_iface
