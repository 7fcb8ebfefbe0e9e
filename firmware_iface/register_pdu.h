// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "haarlight/core/error.h"
#include "haarlight/firmware_iface/register_map.h"

/// @file
/// The host's side of Modbus protocol data units [Modbus12] for transports that libmodbus does
/// not support (USB): building requests and parsing replies. Pure; safe from any thread.

namespace haarlight::firmware_iface {

enum class ReadFunction : std::uint8_t { holding = 3, input = 4 };

/// @param n  1 .. kMaxRegistersRead
[[nodiscard]] std::vector<std::uint8_t> read_request(ReadFunction function, std::uint16_t first,
                                                     std::size_t n);
/// @param words  1 .. kMaxRegistersWritten
[[nodiscard]] std::vector<std::uint8_t> write_registers_request(
    std::uint16_t first, std::span<const std::uint16_t> words);
/// @param bits  1 .. kMaxCoilsWritten, each 0 or 1
[[nodiscard]] std::vector<std::uint8_t> write_coils_request(std::uint16_t first,
                                                            std::span<const std::uint8_t> bits);

/// Parses the reply to a read_request into `words`. An exception reply is a result, `none`
/// fills every word. Fault protocol: not the reply to that request.
[[nodiscard]] Result<registers::Exception> read_reply(std::span<const std::uint8_t> pdu,
                                                      ReadFunction function,
                                                      std::span<std::uint16_t> words);
/// Checks the reply to a write request. Fault protocol: not the reply to that request.
[[nodiscard]] Result<registers::Exception> write_reply(std::span<const std::uint8_t> pdu,
                                                       std::span<const std::uint8_t> request);

}  // namespace haarlight::firmware_iface
