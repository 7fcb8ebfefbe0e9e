// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "sim/controller_server.h"

/// @file
/// The simulated light controller as a USB device: its descriptors, its control requests and
/// its two bulk endpoints, without any I/O. Its transfers are carried elsewhere: by a usb-redir
/// connection to a virtual machine (usb_redir_server.h), or by ioctls of a test.
/// docs/reference/usb-protocol.md specifies its protocol.

namespace haarlight::sim {

/// A SETUP packet, its numbers in host order.
struct UsbSetup {
  std::uint8_t request_type = 0;
  std::uint8_t request = 0;
  std::uint16_t value = 0;
  std::uint16_t index = 0;
  std::uint16_t length = 0;
};

enum class UsbStatus {
  ok,
  stall,
  pending,  ///< bulk in: nothing to send yet, poll again
  hang,     ///< never completed; the host must cancel it
  gone,     ///< the device left the bus
};

struct UsbAnswer {
  UsbStatus status = UsbStatus::ok;
  std::vector<std::uint8_t> data;  ///< of an IN transfer
};

enum class UsbTransfer { control, bulk_out, bulk_in };

/// What happens to a transfer.
struct UsbFaultRule {
  UsbStatus kind = UsbStatus::stall;  ///< stall, hang or gone
  int skip = 0;                       ///< transfers that pass unharmed first
  int count = 1;                      ///< transfers hit; -1 = all until clear_faults()
  std::optional<UsbTransfer> only = std::nullopt;  ///< only these are counted and hit
};

struct UsbDeviceConfig {
  std::string serial = "HL000001";
  /// pid.codes' id for private tests: a product needs its own.
  std::uint16_t vendor = 0x1209;
  std::uint16_t product = 0x0001;
  std::string product_name = "haarlight light array (simulated)";
  std::uint16_t max_packet = 512;  ///< 512 = high speed, 64 = full speed
  // Not 1 and 1, so that a driver has to read them.
  std::uint8_t endpoint_out = 0x02;
  std::uint8_t endpoint_in = 0x83;
};

/// Thread-safe.
class UsbLightDevice {
 public:
  /// Keeps a reference to `controller`.
  UsbLightDevice(UsbDeviceConfig config, ControllerServer& controller);

  [[nodiscard]] const UsbDeviceConfig& config() const noexcept { return config_; }
  [[nodiscard]] std::vector<std::uint8_t> device_descriptor() const;
  /// Including its interface and endpoints.
  [[nodiscard]] std::vector<std::uint8_t> configuration_descriptor() const;

  /// A control transfer; also answers standard requests, except SET_ADDRESS and
  /// SET_CONFIGURATION. Vendor requests are transfers that faults can hit.
  [[nodiscard]] UsbAnswer control(const UsbSetup& setup, std::span<const std::uint8_t> data);
  [[nodiscard]] UsbAnswer bulk_out(std::span<const std::uint8_t> data);
  /// A new IN transfer. One at a time; `hang` and `pending` stay open until cancelled.
  [[nodiscard]] UsbAnswer begin_bulk_in();
  /// Whether a `pending` IN transfer can be completed now.
  [[nodiscard]] UsbAnswer poll_bulk_in();
  /// When poll_bulk_in() may return more (CLOCK_MONOTONIC ns); nothing: after another bulk_out.
  [[nodiscard]] std::optional<std::int64_t> next_reply_ns() const;
  void clear_halt(std::uint8_t endpoint);
  /// Bus reset or new connection: no halt, no partial request, no reply waiting. The light
  /// stays.
  void reset();

  // Faults.
  void inject(const UsbFaultRule& rule);
  void clear_faults();
  /// Transfers begun, including vendor control requests.
  [[nodiscard]] std::uint64_t n_transfers() const;

 private:
  struct Reply {
    std::vector<std::uint8_t> bytes;
    std::int64_t ready_ns = 0;
  };
  [[nodiscard]] std::optional<UsbStatus> next_fault(UsbTransfer transfer);
  [[nodiscard]] UsbAnswer standard_request(const UsbSetup& setup);
  [[nodiscard]] UsbAnswer vendor_request(const UsbSetup& setup);
  [[nodiscard]] std::vector<std::uint8_t> string_descriptor(std::uint8_t index) const;
  [[nodiscard]] UsbAnswer take_reply();
  /// Carries out the complete requests received so far.
  [[nodiscard]] UsbAnswer carry_out();

  UsbDeviceConfig config_;
  ControllerServer& controller_;
  mutable std::mutex mutex_;
  std::vector<UsbFaultRule> rules_;
  std::uint64_t n_transfers_ = 0;
  bool is_out_halted_ = false;
  bool is_in_halted_ = false;
  std::vector<std::uint8_t> received_;
  std::vector<Reply> replies_;
};

}  // namespace haarlight::sim
