// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <chrono>
#include <span>
#include <string_view>

#include "firmware_iface/register_bus.h"
#include "haarlight/core/enum_words.h"
#include "haarlight/core/error.h"

/// @file
/// The state machine of a controller link, as a pure function. libmodbus's own error recovery
/// is off: it sleeps, replays and mistakes late answers for fresh ones.
///
///     closed ──open──▶ unknown ──resynchronised──▶ up
///       ▲                ▲  ▲                       │ fault
///       │close           │  └──settle (RTU)─────────┤
///     (any)              └──open── lost ◀──gone, or any fault of a bus that reopens

namespace haarlight::firmware_iface {

enum class LinkState {
  closed,   ///< no link was requested
  unknown,  ///< open; what the controller holds and shows is unknown
  up,       ///< open and known
  lost,     ///< closed by a fault; reopened at the next call after the back-off
};
inline constexpr auto kLinkStateWords =
    std::to_array<std::string_view>({"closed", "unknown", "up", "lost"});
constexpr std::span<const std::string_view> words_of(LinkState) { return kLinkStateWords; }

enum class LinkEvent {
  opened,          ///< the bus is open
  resynchronised,  ///< line proven by an echo; bank and light read back or all turned off
  fault_gone,      ///< the other side is not there
  fault_line,      ///< timeout or protocol: an answer may be late, a write unconfirmed
  doubt,           ///< the line works, but the controller is not in the state we expected
  close,           ///< by the owner
};

[[nodiscard]] LinkState next_link_state(LinkState state, LinkEvent event, BusRecovery recovery);

/// The event corresponding to a fault of a bus.
[[nodiscard]] LinkEvent link_event(const Fault& fault) noexcept;

/// Pause before the n-th consecutive reopening (n from 0): 0, then 50 ms doubling up to 1 s.
[[nodiscard]] std::chrono::milliseconds reopen_pause(int n_failures);

}  // namespace haarlight::firmware_iface
