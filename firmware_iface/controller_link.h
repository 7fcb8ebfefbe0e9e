// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "firmware_iface/link_state.h"
#include "firmware_iface/register_bus.h"
#include "haarlight/core/error.h"

/// @file
/// A controller's bus, and how much the host knows of the controller behind it.

namespace haarlight::firmware_iface {

/// Monotonic nanoseconds; a virtual one in simulations.
using NanosecondClock = std::function<std::int64_t()>;
[[nodiscard]] std::int64_t monotonic_now_ns();

/// The retry policy: a request that may fail until the pause after a lost link is over, or one
/// that must try now (connecting, turning off).
enum class RetryPolicy { patient, at_once };

/// The link to one controller: next_link_state() with its bus, clock and pauses. A light array
/// calls make_ready() before every request and reports what went wrong.
class ControllerLink {
 public:
  ControllerLink(std::unique_ptr<RegisterBus> bus, NanosecondClock clock);

  [[nodiscard]] RegisterBus& bus() noexcept { return *bus_; }
  [[nodiscard]] std::string name() const { return bus_->name(); }
  [[nodiscard]] LinkState state() const noexcept { return state_; }
  [[nodiscard]] std::int64_t now_ns() const { return clock_(); }

  void on(LinkEvent event);
  /// Records a fault of the bus and passes it on.
  tl::unexpected<Fault> lose(Fault fault);
  /// Opens the bus or lets its line fall silent where necessary, then has `resynchronise` find
  /// out what the controller holds and shows; that reports a fault by lose() itself. Does
  /// nothing on a link that is up.
  [[nodiscard]] Result<void> make_ready(RetryPolicy retry_policy,
                                        const std::function<Result<void>()>& resynchronise);
  /// Called by the owner; the next make_ready() must be at_once.
  void close() noexcept;

 private:
  [[nodiscard]] Result<void> open();
  void wait_to_reopen();

  std::unique_ptr<RegisterBus> bus_;
  NanosecondClock clock_;
  LinkState state_ = LinkState::closed;
  int n_open_failures_ = 0;  ///< in a row
  std::int64_t reopen_at_ns_ = 0;
};

}  // namespace haarlight::firmware_iface
