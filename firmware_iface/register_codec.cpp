// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/register_codec.h"

#include <cctype>
#include <string>

#include <fmt/format.h>

namespace haarlight::firmware_iface {

namespace {

namespace in = registers::input;

std::uint32_t long_at(std::span<const std::uint16_t> words, std::size_t offset) {
  return join_words(words[offset], words[offset + 1]);
}

}  // namespace

std::uint32_t bank_sum(std::span<const ElementLevel> pattern) {
  std::uint32_t sum = 0;
  for (const ElementLevel& e : pattern) {
    sum += bank_sum_term(e.element, e.level);
  }
  return sum;
}

Result<ControllerIdentity> decode_identity(std::span<const std::uint16_t> words) {
  if (words.size() != in::kIdentityCount) {
    return fail(Errc::protocol, fmt::format("controller identity: {} registers, expected {}",
                                            words.size(), in::kIdentityCount));
  }
  if (words[in::kMagic] != registers::kMagic) {
    return fail(Errc::protocol,
                fmt::format("controller identity: magic {:#06x}, expected {:#06x}: "
                            "this is no haarlight light controller",
                            words[in::kMagic], registers::kMagic));
  }
  if (words[in::kMapVersion] != registers::kMapVersion) {
    return fail(Errc::protocol,
                fmt::format("controller identity: register map {}, this program knows map {}",
                            words[in::kMapVersion], registers::kMapVersion));
  }
  ControllerIdentity identity;
  identity.serial = long_at(words, in::kSerial);
  identity.firmware = long_at(words, in::kFirmware);
  identity.n_elements = words[in::kElements];
  identity.table_depth = words[in::kTableDepth];
  if (identity.n_elements < 1 || identity.n_elements > registers::kMaxElements) {
    return fail(Errc::protocol,
                fmt::format("controller identity: {} elements, expected 1 to {}",
                            identity.n_elements, registers::kMaxElements));
  }
  for (std::size_t i = in::kModel; i < in::kIdentityCount; ++i) {
    for (const unsigned byte : {unsigned{words[i]} >> 8U, unsigned{words[i]} & 0xFFU}) {
      if (byte == 0) {
        return identity;
      }
      identity.model.push_back(
          std::isprint(static_cast<int>(byte)) != 0 ? static_cast<char>(byte) : '?');
    }
  }
  return identity;
}

Result<StatusBlock> decode_status(std::span<const std::uint16_t> words) {
  if (words.size() != in::kStatusCount) {
    return fail(Errc::protocol, fmt::format("controller status: {} registers, expected {}",
                                            words.size(), in::kStatusCount));
  }
  const auto at = [&words](std::uint16_t address) {
    return words[static_cast<std::size_t>(address - in::kStatusFirst)];
  };
  const auto long_value = [&words](std::uint16_t address) {
    return long_at(words, static_cast<std::size_t>(address - in::kStatusFirst));
  };
  StatusBlock block;
  block.bits = at(in::kStatusBits);
  block.shown_sum = long_value(in::kShownSum);
  block.shadow_sum = long_value(in::kShadowSum);
  block.latch_counter = long_value(in::kLatchCounter);
  block.refusal = static_cast<registers::Refusal>(at(in::kRefusal));
  block.status.boot_id = long_value(in::kBootId);
  block.status.uptime_ms = long_value(in::kUptimeMs);
  block.status.faults = long_value(in::kFaults);
  block.status.temperature_c = 0.1 * static_cast<std::int16_t>(at(in::kTemperature));
  block.status.supply_a = 0.01 * at(in::kSupplyCurrent);
  block.status.tag = long_value(in::kTag);
  block.status.step_counter = long_value(in::kStepCounter);
  block.status.is_dark = (block.bits & registers::kStatusDark) != 0;
  block.status.is_armed = (block.bits & registers::kStatusArmed) != 0;
  block.status.is_table_done = (block.bits & registers::kStatusTableDone) != 0;
  if (block.status.is_dark && (block.shown_sum != 0 || long_value(in::kPower) != 0)) {
    return fail(
        Errc::protocol,
        fmt::format("controller status: says dark, yet shows sum {:#010x} and {} x 0.1 W",
                    block.shown_sum, long_value(in::kPower)));
  }
  return block;
}

std::string_view reason_of(registers::Refusal refusal) noexcept {
  using enum registers::Refusal;
  switch (refusal) {
    case none:
      return "no reason given";
    case total_power:
      return "more power than the controller's limit";
    case group_power:
      return "more power than one string's limit";
    case element_duty:
      return "an element is beyond its thermal duty";
    case over_temperature:
      return "the board is too hot";
    case interlock:
      return "the interlock is open";
    case bank_sum:
      return "the bank does not hold what the host believes";
    case tag_zero:
      return "tag 0 means dark";
    case table_range:
      return "beyond the pattern table";
    case table_not_armed:
      return "no pattern table is armed";
  }
  return "unknown reason";
}

}  // namespace haarlight::firmware_iface
