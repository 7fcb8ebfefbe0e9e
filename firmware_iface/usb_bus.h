// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <memory>
#include <string>

#include "firmware_iface/register_bus.h"

/// @file
/// The registers over USB: docs/reference/usb-protocol.md specifies the protocol, usb_link.h is
/// the device.

namespace haarlight::firmware_iface {

struct UsbTiming {
  /// From a request's first byte to the last one of its answer.
  std::chrono::milliseconds turnaround{250};
  /// Finding the device by its serial number and claiming it.
  std::chrono::milliseconds open{1500};
};

/// A late answer carries an older sequence number and is discarded; so settle() only clears
/// stalls and asks the controller to forget what it has not sent yet.
/// @param serial  of the device, whichever port it is plugged in to
[[nodiscard]] std::unique_ptr<RegisterBus> make_usb_bus(std::string serial,
                                                        UsbTiming timing = {});

/// Turns everything off by the control endpoint, next to a program (or a hanging thread) that
/// holds the registers' interface.
/// Faults: device_gone, device_busy (no permission), timeout, protocol, io.
[[nodiscard]] Result<void> usb_all_off(const std::string& serial, UsbTiming timing = {});

}  // namespace haarlight::firmware_iface
