// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/controller_link.h"

#include <chrono>
#include <utility>

#include <fmt/format.h>

namespace haarlight::firmware_iface {

std::int64_t monotonic_now_ns() {
  // libstdc++'s steady_clock is CLOCK_MONOTONIC.
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

ControllerLink::ControllerLink(std::unique_ptr<RegisterBus> bus, NanosecondClock clock)
    : bus_(std::move(bus)), clock_(std::move(clock)) {
  HAARLIGHT_EXPECTS(bus_ != nullptr, "a light array needs a bus");
}

void ControllerLink::on(LinkEvent event) {
  const LinkState old = state_;
  state_ = next_link_state(state_, event, bus_->recovery());
  if (state_ == LinkState::up) {
    n_open_failures_ = 0;
  }
  if (state_ == LinkState::lost && old != LinkState::lost) {
    bus_->close();
    wait_to_reopen();
  }
}

tl::unexpected<Fault> ControllerLink::lose(Fault fault) {
  on(link_event(fault));
  return tl::unexpected<Fault>(std::move(fault));
}

void ControllerLink::wait_to_reopen() {
  reopen_at_ns_ = clock_() + std::chrono::nanoseconds(reopen_pause(n_open_failures_)).count();
}

Result<void> ControllerLink::open() {
  bus_->close();
  auto opened = bus_->open();
  if (!opened) {
    ++n_open_failures_;
    state_ = LinkState::lost;
    wait_to_reopen();
    return opened;
  }
  on(LinkEvent::opened);
  return {};
}

Result<void> ControllerLink::make_ready(RetryPolicy retry_policy,
                                        const std::function<Result<void>()>& resynchronise) {
  switch (state_) {
    case LinkState::up:
      return {};
    case LinkState::closed:
      if (retry_policy == RetryPolicy::patient) {
        return fail(Errc::device_gone, name() + ": not connected");
      }
      break;
    case LinkState::lost: {
      const std::int64_t left_ns = reopen_at_ns_ - clock_();
      if (retry_policy == RetryPolicy::patient && left_ns > 0) {
        return fail(Errc::device_gone, fmt::format("{}: link lost, opened again in {} ms",
                                                   name(), left_ns / 1'000'000 + 1));
      }
      break;
    }
    case LinkState::unknown: {
      if (auto settled = bus_->settle(); !settled) {
        return lose(settled.error());
      }
      return resynchronise();
    }
  }
  if (auto opened = open(); !opened) {
    return opened;
  }
  return resynchronise();
}

void ControllerLink::close() noexcept {
  bus_->close();
  state_ = LinkState::closed;
  n_open_failures_ = 0;
}

}  // namespace haarlight::firmware_iface
