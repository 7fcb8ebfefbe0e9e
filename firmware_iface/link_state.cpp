// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/link_state.h"

#include <algorithm>

namespace haarlight::firmware_iface {

LinkState next_link_state(LinkState state, LinkEvent event, BusRecovery recovery) {
  using enum LinkState;
  switch (event) {
    case LinkEvent::opened:
      return unknown;
    case LinkEvent::resynchronised:
      return state == unknown || state == up ? up : state;
    case LinkEvent::fault_gone:
      return state == closed ? closed : lost;
    case LinkEvent::fault_line:
      if (state == closed || state == lost) {
        return state;
      }
      return recovery == BusRecovery::reopen ? lost : unknown;
    case LinkEvent::doubt:
      return state == up ? unknown : state;
    case LinkEvent::close:
      return closed;
  }
  return closed;
}

LinkEvent link_event(const Fault& fault) noexcept {
  switch (fault.code) {
    case Errc::timeout:
    case Errc::protocol:
      return LinkEvent::fault_line;
    case Errc::device_gone:
    case Errc::device_busy:
    case Errc::io:
    case Errc::no_space:
    case Errc::refused:
    case Errc::unsupported:
      return LinkEvent::fault_gone;
  }
  return LinkEvent::fault_gone;
}

std::chrono::milliseconds reopen_pause(int n_failures) {
  if (n_failures <= 0) {
    return std::chrono::milliseconds(0);
  }
  constexpr int kFirstMs = 50;
  constexpr int kLongestMs = 1000;
  return std::chrono::milliseconds(
      std::min(kFirstMs << std::min(n_failures - 1, 5), kLongestMs));
}

}  // namespace haarlight::firmware_iface
