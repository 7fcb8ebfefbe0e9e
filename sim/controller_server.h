// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "firmware_iface/light_controller.h"

/// @file
/// A simulated light controller on real wires: a Modbus TCP server on the loopback and a Modbus
/// RTU server on a pseudo-terminal whose bytes are paced at a baud rate. One LightController
/// behind both, its lease kept by a thread on CLOCK_MONOTONIC. Faults are injected by call.

namespace haarlight::sim {

struct ControllerServerOptions {
  firmware_iface::ControllerConfig controller;
  int unit = 1;
  bool has_tcp = true;
  int tcp_port = 0;  ///< 0 = any free one; see tcp_address()
  bool has_rtu = false;
  int baud = 115200;  ///< 8E1: 11 bits per byte. 0 = as fast as possible
  std::uint32_t first_boot_id = 1;
  /// A pulse on the camera's trigger line comes at `t_ns`. Called within a request.
  std::function<void(std::int64_t t_ns)> trigger{};
};

/// What happens to a request or its reply.
enum class WireFault {
  drop_request,       ///< lost before it acts
  drop_reply,         ///< acted upon, not answered: a dead bus
  delay_reply,        ///< answered `delay` late
  half_reply,         ///< the first half of the answer, then silence
  garbage_reply,      ///< bytes that are not an answer, then silence
  wrong_unit,         ///< the answer names another unit
  wrong_transaction,  ///< TCP: the answer carries another transaction id
  exception,          ///< not acted upon, answered by `exception`
  close,              ///< acted upon, then the connection is closed (RTU: the cable is pulled)
};

struct WireFaultRule {
  WireFault kind = WireFault::drop_reply;
  int skip = 0;   ///< requests that pass unharmed first
  int count = 1;  ///< requests hit; -1 = all until clear_faults()
  std::chrono::milliseconds delay{0};
  firmware_iface::registers::Exception exception =
      firmware_iface::registers::Exception::device_failure;
  int function = 0;  ///< only requests of this Modbus function are counted and hit; 0 = all
};

/// The outcome of a request that came by another wire (USB).
struct WireExchange {
  std::vector<std::uint8_t> pdu;       ///< the reply; empty: none
  std::optional<WireFaultRule> fault;  ///< to be applied to the reply, beyond its delay
  std::chrono::nanoseconds delay{0};   ///< before it may be sent
};

/// Runs from construction to destruction. Thread-safe.
class ControllerServer {
 public:
  /// @throws Error  the port is taken, no pseudo-terminal
  explicit ControllerServer(ControllerServerOptions options);
  ~ControllerServer();
  ControllerServer(const ControllerServer&) = delete;
  ControllerServer& operator=(const ControllerServer&) = delete;

  /// "127.0.0.1:PORT"
  [[nodiscard]] std::string tcp_address() const;
  /// A link that keeps its name across replug_rtu(), like /dev/serial/by-id.
  [[nodiscard]] std::filesystem::path rtu_path() const;
  /// "PATH:BAUD", as in a rig file.
  [[nodiscard]] std::string rtu_address() const;

  /// Carries out one Modbus PDU that came by a wire of the caller's own; never sleeps.
  [[nodiscard]] WireExchange exchange(std::span<const std::uint8_t> pdu);
  /// ALL_OFF by a path of its own (USB's control endpoint).
  void all_off();
  /// The identity registers, from registers::input::kMagic on.
  [[nodiscard]] std::vector<std::uint16_t> identity();

  // Light.
  /// The state at t0 and each change in (t0, t1]; t1 in the past (CLOCK_MONOTONIC ns).
  [[nodiscard]] firmware_iface::LightHistory transitions(std::int64_t t0_ns,
                                                         std::int64_t t1_ns);
  [[nodiscard]] firmware_iface::LightTransition lit();
  [[nodiscard]] double total_on_seconds(int element);
  [[nodiscard]] std::uint32_t boot_id();
  /// Requests carried out or dropped so far, of both servers; counted before the reply, and
  /// before lit() or total_on_seconds() sees what a request did.
  [[nodiscard]] std::uint64_t n_requests() const;

  // The world around it.
  /// An edge on the camera's strobe line, now.
  void strobe();
  /// The same at `t_ns`, announced in advance. It acts at exactly that time, before any request
  /// that comes later, however late this machine is.
  void strobe_at(std::int64_t t_ns);
  /// Power lost: dark at once, connections cut, back with a new boot id after `off_for`.
  void restart(std::chrono::milliseconds off_for);
  void set_interlock_open(bool is_open);
  void set_temperature(double temperature_c);
  /// Pulls the serial cable: the client's device is gone.
  void unplug_rtu();
  /// Plugs it in again, as another device under the same link.
  void replug_rtu();
  /// It acknowledges at once and acts late; a fraction of 0 ends it.
  void set_late_acting(const firmware_iface::LateActing& late);
  /// Every reply is delayed by this much (a slow bus).
  void set_reply_delay(std::chrono::microseconds delay);
  /// Rules are tried in the order given; the first one that hits a request decides.
  void inject(const WireFaultRule& rule);
  void clear_faults();

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace haarlight::sim
