// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

/// @file
/// The serial lines of this machine, under stable names, and what slows them down.

namespace haarlight::firmware_iface {

struct SerialPort {
  std::filesystem::path by_id;   ///< "/dev/serial/by-id/usb-FTDI_..."; empty: no such name
  std::filesystem::path device;  ///< "/dev/ttyUSB0": changes whenever it is plugged in
  std::string driver;            ///< the kernel's: "ftdi_sio", "cp210x", "cdc_acm"
  /// How long an FTDI chip delays a short answer, ms; nothing: no such timer.
  std::optional<int> latency_ms;
};

/// USB-serial lines, by name.
/// @param root  of the file system ("/"); a different one in tests
[[nodiscard]] std::vector<SerialPort> list_serial_ports(
    const std::filesystem::path& root = "/");

/// What is unwise about a rig file's serial line, with a hint; empty when nothing is.
/// @param device  as named in the rig file
[[nodiscard]] std::vector<std::string> serial_advice(const std::filesystem::path& device,
                                                     const std::filesystem::path& root = "/");

}  // namespace haarlight::firmware_iface
