// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <memory>

#include "sim/usb_device.h"

/// @file
/// Plugs a UsbLightDevice into a virtual machine: speaks the usb-redir protocol that QEMU's
/// `usb-redir` device understands, over a unix socket (QEMU outside connects to it) or over a
/// character device (the simulator itself runs inside the machine and reaches QEMU by a
/// virtio-serial port). The guest's own kernel, its host controller driver and libusb then see
/// an ordinary device. docs/reference/simulator.md shows both.

namespace haarlight::sim {

/// Runs from construction to destruction, one thread of its own. Thread-safe.
class UsbRedirServer {
 public:
  /// Listens on `path`; a stale socket file is replaced, a live one refused. An existing
  /// character device is opened instead. The device is plugged in as soon as a peer connects.
  /// Keeps a reference to `device`.
  /// @throws Error  unusable path
  UsbRedirServer(UsbLightDevice& device, std::filesystem::path path);
  ~UsbRedirServer();
  UsbRedirServer(const UsbRedirServer&) = delete;
  UsbRedirServer& operator=(const UsbRedirServer&) = delete;

  /// Takes the device off the bus; transfers in flight are lost with it.
  void unplug();
  /// Plugs it in again.
  void replug();
  /// A peer is connected and sees the device.
  [[nodiscard]] bool is_attached() const;
  [[nodiscard]] const std::filesystem::path& path() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace haarlight::sim
