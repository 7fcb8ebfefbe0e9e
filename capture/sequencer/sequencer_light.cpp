// SPDX-License-Identifier: Apache-2.0
/// @file
/// The sequencer: the light controller, present or lost.

#include <algorithm>

#include <fmt/format.h>

#include "capture/sequencer/stepper.h"

namespace haarlight::capture {

using namespace sequencing;

namespace sequencing {

std::int64_t backoff_ns(int faults) {
  const int doublings = std::clamp(faults - 1, 0, 10);
  return std::min(kFirstBackoffNs << doublings, kLastBackoffNs);
}

}  // namespace sequencing

void Stepper::on(const event::LightConnected& e) {
  if (e.job != s_.job) {
    return;
  }
  if (s_.boot_id != 0 && s_.boot_id != e.boot_id) {
    ++s_.counters.controller_reboots;
    log(session::EventKind::controller,
        fmt::format("started again (boot {} after {})", e.boot_id, s_.boot_id));
  }
  s_.boot_id = e.boot_id;
  s_.is_job_open = false;
  note_job_end();
  s_.table_depth = e.table_depth;
  s_.block.table.clear();
  s_.is_light_connected = true;
  s_.is_dark = true;
  became_ready(kControllerLost);
}

void Stepper::on(const event::LightDark& e) {
  if (e.job == s_.job) {
    s_.is_job_open = false;
    s_.light_faults = 0;
    note_job_end();
  }
}

void Stepper::on(const event::LightFault& e) {
  if (s_.awaiting && s_.awaiting->job == e.job) {
    const SequencerState::Awaiting waiting = *std::move(s_.awaiting);
    s_.awaiting.reset();
    drop(waiting.frame);
    return_to_pending(waiting.shot);
  }
  if (e.job == 0 && s_.is_light_connected) {
    ++s_.counters.light_faults;
    ++s_.light_faults;
    const int shot = shot_under_way();
    leave_shot();
    lose_controller("controller: " + e.what, t_ + backoff_ns(s_.light_faults), shot);
  } else if (e.job == s_.job && (s_.is_job_open || is_block_armed())) {
    on_light_fault(e.code, e.what);
  }
}

void Stepper::connect_light() {
  s_.retry_light_ns = kNever;
  s_.is_job_open = true;
  out_.emplace_back(action::ConnectLight{++s_.job});
}

void Stepper::lights_off(std::optional<ConfirmRequest> confirm) {
  s_.is_dark = true;
  s_.is_job_open = true;
  out_.emplace_back(action::LightsOff{++s_.job, confirm});
}

void Stepper::darken() {
  if (s_.is_light_connected && !s_.is_dark) {
    lights_off(std::nullopt);
  }
}

void Stepper::darken_always() {
  if (s_.is_light_connected || !s_.is_job_open) {
    lights_off(std::nullopt);
  }
}

void Stepper::on_light_fault(Errc code, const std::string& what) {
  ++s_.counters.light_faults;
  ++s_.light_faults;
  s_.is_job_open = false;
  note_job_end();
  const int shot = shot_under_way();
  leave_shot();
  s_.block.table.clear();  // what a fault left of it is unknown
  const bool was_connected = s_.is_light_connected;
  if ((code == Errc::refused || code == Errc::unsupported) && is_shooting()) {
    // Before the first light a refusal is final. Later it contradicts what the same controller
    // accepted a moment ago: a stray answer would end a good run.
    if (!s_.has_shown || ++s_.refusals >= kRefusalsToEnd) {
      abort(s_.has_shown ? fmt::format("controller: {} ({} times in a row)", what, s_.refusals)
                         : "controller: " + what);
      return;
    }
    if (was_connected && s_.phase != Phase::suspended) {
      s_.retry_held_ns = t_ + kHeldRetryNs;
      s_.is_dark = false;  // what was lit before may still be lit
      add_reason(kHeldBack,
                 fmt::format("controller: {}: asked again ({} of {})", what, s_.refusals,
                             kRefusalsToEnd - 1),
                 shot);
      return;
    }
  }
  // A busy one that is not even connected is told to connect again, not to show again.
  if (code == Errc::device_busy && was_connected) {
    s_.retry_held_ns = t_ + kHeldRetryNs;
    s_.is_dark = false;  // what was lit before may still be lit
    add_reason(kHeldBack, "controller: " + what, shot);
    return;
  }
  if (!was_connected || code == Errc::device_gone || s_.light_faults >= kLightFaultsToLose) {
    lose_controller("controller: " + what, t_ + backoff_ns(s_.light_faults), shot);
    return;
  }
  log(session::EventKind::light, what, shot);
  s_.is_dark = false;  // unknown: off, or latched again
  if (s_.phase == Phase::running) {
    advance(std::nullopt);
  } else {
    darken();
  }
}

void Stepper::lose_controller(const std::string& what, std::int64_t retry_ns, int shot) {
  s_.is_light_connected = false;
  s_.is_job_open = false;
  s_.block.table.clear();
  const bool is_needed = s_.plan != nullptr && s_.phase != Phase::done &&
                         s_.phase != Phase::idle && s_.phase != Phase::aborting;
  if (is_needed || s_.phase == Phase::safe_off) {
    s_.retry_light_ns = retry_ns;
    add_reason(kControllerLost, what, shot);
  }
}

}  // namespace haarlight::capture
