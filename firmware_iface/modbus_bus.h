#pragma once

#include <chrono>
#include <memory>
#include <string>

#include "firmware_iface/register_bus.h"

/// @file
/// Modbus TCP and RTU over libmodbus, whose own error recovery stays off.

namespace haarlight {

struct TcpAddress {
  std::string host;     ///< name, IPv4 or IPv6 address
  std::string service;  ///< port number
};

enum class Parity : char { none = 'N', even = 'E', odd = 'O' };

struct SerialAddress {
  std::string device;
  int baud = 115200;
  int data_bits = 8;
  Parity parity = Parity::even;  ///< Modbus's default
  int stop_bits = 1;
};

/// "host:port", "[::1]:port". Fault unsupported: not of that form.
[[nodiscard]] Result<TcpAddress> parse_tcp_address(const std::string& text);
/// "/dev/...:baud" or "/dev/...:baud:8E1"; the device may contain colons (by-path).
[[nodiscard]] Result<SerialAddress> parse_serial_address(const std::string& text);

struct ModbusTiming {
  /// From the end of a request on the wire to the beginning of its answer. Time for the bytes
  /// themselves is added (RTU).
  std::chrono::milliseconds turnaround{250};
  std::chrono::milliseconds connect{500};
  /// RTU: after a fault the line must be silent this long. Longer than the latest possible
  /// answer (docs/register-map.md: firmware answers within 500 ms or never).
  std::chrono::milliseconds quiet{1000};
};

/// @param unit  1 .. 247
[[nodiscard]] std::unique_ptr<RegisterBus> make_modbus_tcp_bus(const TcpAddress& address,
                                                               int unit,
                                                               ModbusTiming timing = {});
[[nodiscard]] std::unique_ptr<RegisterBus> make_modbus_rtu_bus(const SerialAddress& address,
                                                               int unit,
                                                               ModbusTiming timing = {});

}  // namespace haarlight
