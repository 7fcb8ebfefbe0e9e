// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/serial_ports.h"

#include <algorithm>
#include <fstream>
#include <system_error>

#include <fmt/format.h>

namespace haarlight::firmware_iface {

namespace {

namespace fs = std::filesystem;

fs::path under(const fs::path& root, const fs::path& absolute) {
  return root / absolute.relative_path();
}

/// The tty behind a name: the target of its last link, without checking that it exists.
std::string tty_of(const fs::path& name) {
  std::error_code failed;
  const fs::path target = fs::read_symlink(name, failed);
  return failed ? name.filename().string() : target.filename().string();
}

SerialPort describe(const fs::path& root, const std::string& tty) {
  SerialPort port;
  port.device = fs::path("/dev") / tty;
  std::error_code failed;
  const fs::path driver =
      fs::read_symlink(under(root, "/sys/class/tty") / tty / "device" / "driver", failed);
  port.driver = failed ? "" : driver.filename().string();
  int ms = 0;
  if (std::ifstream timer(under(root, "/sys/bus/usb-serial/devices") / tty / "latency_timer");
      timer >> ms) {
    port.latency_ms = ms;
  }
  return port;
}

}  // namespace

std::vector<SerialPort> list_serial_ports(const fs::path& root) {
  std::vector<SerialPort> ports;
  std::error_code failed;
  for (const auto& entry : fs::directory_iterator(under(root, "/dev/serial/by-id"), failed)) {
    SerialPort port = describe(root, tty_of(entry.path()));
    port.by_id = fs::path("/dev/serial/by-id") / entry.path().filename();
    ports.push_back(std::move(port));
  }
  for (const auto& entry : fs::directory_iterator(under(root, "/sys/class/tty"), failed)) {
    const std::string tty = entry.path().filename().string();
    const bool is_usb = tty.starts_with("ttyUSB") || tty.starts_with("ttyACM");
    const bool is_known = std::any_of(ports.begin(), ports.end(), [&tty](const SerialPort& p) {
      return p.device.filename() == tty;
    });
    if (is_usb && !is_known) {
      ports.push_back(describe(root, tty));
    }
  }
  std::sort(ports.begin(), ports.end(), [](const SerialPort& a, const SerialPort& b) {
    return std::pair(a.by_id, a.device) < std::pair(b.by_id, b.device);
  });
  return ports;
}

std::vector<std::string> serial_advice(const fs::path& device, const fs::path& root) {
  std::vector<std::string> advice;
  const std::string tty = tty_of(under(root, device));
  if (!tty.starts_with("ttyUSB") && !tty.starts_with("ttyACM")) {
    return advice;
  }
  if (device.filename() == tty) {
    std::string better = "its name in /dev/serial/by-id";
    for (const SerialPort& port : list_serial_ports(root)) {
      if (port.device.filename() == tty && !port.by_id.empty()) {
        better = port.by_id.string();
      }
    }
    advice.push_back(
        fmt::format("{} may be another device after the next plugging: write {} as the "
                    "controller's address",
                    device.string(), better));
  }
  if (const SerialPort port = describe(root, tty); port.latency_ms.value_or(1) > 1) {
    advice.push_back(
        fmt::format("{} holds each answer back for up to {} ms (FTDI latency timer): echo 1 > "
                    "/sys/bus/usb-serial/devices/{}/latency_timer, or install "
                    "configs/udev/99-haarlight.rules",
                    device.string(), *port.latency_ms, tty));
  }
  return advice;
}

}  // namespace haarlight::firmware_iface
