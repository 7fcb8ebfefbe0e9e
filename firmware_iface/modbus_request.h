// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "firmware_iface/light_controller.h"

/// @file
/// Modbus protocol data units answered by a LightController: [Modbus12] MODBUS Application
/// Protocol V1.1b3, functions 1 to 6, 15 and 16. Framing (TCP header, RTU address and CRC) is
/// left to the server.

namespace haarlight::firmware_iface {

inline constexpr std::size_t kMaxPduBytes = 253;

/// Carries out one request.
/// @param pdu  function code and data, as received; any bytes are answered, with an exception
/// where they are not a valid request
/// @return     the reply's PDU, 2 .. 253 bytes; empty for an empty request
[[nodiscard]] std::vector<std::uint8_t> answer_request(LightController& controller,
                                                       std::span<const std::uint8_t> pdu,
                                                       std::int64_t now_ns);

/// The exception reply to `function`.
[[nodiscard]] std::vector<std::uint8_t> exception_reply(std::uint8_t function,
                                                        registers::Exception exception);

}  // namespace haarlight::firmware_iface
