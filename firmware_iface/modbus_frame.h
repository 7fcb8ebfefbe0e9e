// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

/// @file
/// Modbus framing as a server needs it: TCP's header [ModbusTcp06] and RTU's unit, data and CRC
/// [ModbusSerial06]. Pure; safe from any thread. The drivers use libmodbus's framing instead:
/// two implementations that check each other.

namespace haarlight::firmware_iface {

/// One request received from a wire.
struct ModbusRequest {
  std::uint16_t transaction = 0;  ///< TCP only
  std::uint8_t unit = 0;
  std::vector<std::uint8_t> pdu;
};

enum class ScanVerdict {
  need_more,  ///< the beginning of a frame
  complete,   ///< `request` is filled
  broken,     ///< no frame can begin like this (TCP), or the CRC is wrong (RTU)
};

struct FrameScan {
  ScanVerdict verdict = ScanVerdict::need_more;
  std::size_t n_bytes = 0;  ///< of the complete or broken frame
  ModbusRequest request;
};

/// Scans for one request at the beginning of `bytes`.
[[nodiscard]] FrameScan scan_tcp_request(std::span<const std::uint8_t> bytes);
/// RTU requests have no length: it follows from the function code. An unknown function is
/// reported broken with all bytes given; on a real line a pause ends it.
[[nodiscard]] FrameScan scan_rtu_request(std::span<const std::uint8_t> bytes);

[[nodiscard]] std::vector<std::uint8_t> frame_tcp(std::uint16_t transaction, std::uint8_t unit,
                                                  std::span<const std::uint8_t> pdu);
[[nodiscard]] std::vector<std::uint8_t> frame_rtu(std::uint8_t unit,
                                                  std::span<const std::uint8_t> pdu);

/// CRC-16 of Modbus: polynomial 0xA001 (reflected), init 0xFFFF; sent low byte first.
[[nodiscard]] std::uint16_t rtu_crc(std::span<const std::uint8_t> bytes);

}  // namespace haarlight::firmware_iface
