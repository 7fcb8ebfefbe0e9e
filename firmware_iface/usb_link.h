// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "haarlight/core/error.h"

/// @file
/// A light controller's USB device: found by its serial number, transfers with a deadline. Only
/// the .cpp includes libusb.
///
/// One thread per link makes every call into libusb (including opening and clearing a halt), so
/// that a kernel call that never returns blocks that thread and nothing else: the caller's wait
/// ends at its own deadline, and the thread is left behind. The hot-plug callback only records
/// that the device left; nothing is closed inside it.

namespace haarlight::firmware_iface {

class UsbEngine;

/// One light controller on the bus.
struct UsbController {
  std::string serial;   ///< empty when it could not be read
  std::string product;  ///< as reported by the device
  std::uint16_t vendor_id = 0;
  std::uint16_t product_id = 0;
  std::string location;  ///< "bus 1 port 2.3": for display; changes with the port
  std::string problem;   ///< why it cannot be used; empty = it can
};

/// Every USB device with the interface of a light controller, whatever its ids. Does not show
/// whether another program uses it.
/// Faults: unsupported (no USB on this machine), timeout.
[[nodiscard]] Result<std::vector<UsbController>> list_usb_controllers(
    std::chrono::milliseconds limit = std::chrono::milliseconds(3000));

enum class UsbUse {
  claimed,       ///< the registers' interface is ours alone
  only_control,  ///< endpoint 0 only, alongside another user
};

/// The outcome of an IN transfer.
enum class UsbVerdict {
  mine,   ///< the expected reply
  older,  ///< a late one: skip it
  broken  ///< not a reply at all
};

/// A link to one device. One thread owns it; every call ends at its deadline, plus a moment for
/// a loaded machine, whatever the device, the kernel or libusb does.
class UsbLink {
 public:
  UsbLink();
  ~UsbLink();
  UsbLink(const UsbLink&) = delete;
  UsbLink& operator=(const UsbLink&) = delete;

  /// Faults: device_gone (no such serial number; the message lists those present), device_busy
  /// (in use by another program, no permission, or earlier calls still hang), timeout.
  [[nodiscard]] Result<void> open(const std::string& serial, UsbUse use,
                                  std::chrono::milliseconds limit);
  /// Bounded too: transfers are cancelled; a hanging thread is left behind.
  void close() noexcept;
  [[nodiscard]] bool is_open() const noexcept;
  /// The device left the bus, or a call into the kernel hangs.
  [[nodiscard]] bool is_lost() const noexcept;
  /// Of the OUT endpoint.
  [[nodiscard]] std::size_t max_packet() const noexcept;

  /// Sends `out`, then receives until `classify` says mine or broken.
  /// Faults: timeout, device_gone, protocol (a stall, or `broken`), io.
  [[nodiscard]] Result<std::vector<std::uint8_t>> exchange(
      std::span<const std::uint8_t> out,
      std::function<UsbVerdict(std::span<const std::uint8_t>)> classify,
      std::chrono::milliseconds limit);
  /// Vendor requests, recipient device. Same faults.
  [[nodiscard]] Result<std::vector<std::uint8_t>> control_in(std::uint8_t request,
                                                             std::size_t n_bytes,
                                                             std::chrono::milliseconds limit);
  [[nodiscard]] Result<void> control_out(std::uint8_t request, std::chrono::milliseconds limit);
  /// Both bulk endpoints.
  [[nodiscard]] Result<void> clear_halts(std::chrono::milliseconds limit);

 private:
  std::shared_ptr<UsbEngine> engine_;
  std::vector<std::shared_ptr<UsbEngine>> left_behind_;  ///< threads that did not return
};

}  // namespace haarlight::firmware_iface
