// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <string>

#include "sim/usb_device.h"

/// @file
/// A bus of simulated USB devices under umockdev: libusb's own code runs, opens /dev/bus/usb
/// and issues usbfs ioctls; their answers come from a UsbLightDevice. Not covered: the kernel's
/// usbfs and host controller drivers, and poll(), which is always ready here (the virtual
/// machine's test covers them).

namespace haarlight::firmware_iface {

/// One bus. Plugging and unplugging from one thread.
class UsbTestbed {
 public:
  UsbTestbed();
  ~UsbTestbed();
  UsbTestbed(const UsbTestbed&) = delete;
  UsbTestbed& operator=(const UsbTestbed&) = delete;

  /// Puts the device on the bus under the next free address and tells udev. Keeps a reference.
  void plug(sim::UsbLightDevice& device);
  /// Takes it off: its open transfers end, later calls fail with ENODEV.
  void unplug(sim::UsbLightDevice& device);
  /// A fault of the device's own took it off the bus.
  [[nodiscard]] bool is_off(const sim::UsbLightDevice& device) const;
  /// The next `n_users` open nodes that ask for completions do not get an answer to that call
  /// any more: a system that hangs. Nodes opened later work.
  void hold_completions(int n_users);
  void release_completions();
  /// Users whose call hangs now.
  [[nodiscard]] int n_holding() const;
  /// Interfaces claimed and not released.
  [[nodiscard]] int n_claimed() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

/// Restarts the program with umockdev's library preloaded, unless it is.
void require_mock_environment(char** argv);

}  // namespace haarlight::firmware_iface
