// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "haarlight/core/error.h"

/// @file
/// The address of a controller: the `address` of a rig file's [controller].

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

/// "host:port", "[::1]:port", port 1 to 65535. Fault unsupported: not of that form.
[[nodiscard]] Result<TcpAddress> parse_tcp_address(const std::string& text);
/// "/dev/...:baud" or "/dev/...:baud:8E1", 300 to 4 000 000 baud; the device may contain colons
/// (by-path). Fault unsupported: not of that form.
[[nodiscard]] Result<SerialAddress> parse_serial_address(const std::string& text);

}  // namespace haarlight
