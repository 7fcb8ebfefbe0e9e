// SPDX-License-Identifier: Apache-2.0
/// @file
/// The sequencer, one pattern at a time: free-run, light leads and controller leads.

#include <algorithm>
#include <limits>

#include <fmt/format.h>

#include "capture/plan/timing.h"
#include "capture/sequencer/stepper.h"
#include "session/clean_rule.h"

namespace haarlight::capture {

using namespace sequencing;

namespace {

/// A shot that was abandoned may have left a trigger (light leads) or a latch whose pulse
/// (controller leads) still exposes a frame. The next one is delayed until no false timestamp
/// can confuse one exposure with the other.
constexpr std::int64_t kOpenTriggerNs = 20 * kMs;

}  // namespace

void Stepper::on(const event::LightShown& e) {
  if (e.job != s_.job || s_.current < 0 || s_.step != ShotStep::light) {
    return;
  }
  s_.is_job_open = false;
  const std::uint32_t tag = shot_of(s_.current).tag;
  if (e.receipt.tag_echo != tag) {
    on_light_fault(Errc::protocol,
                   fmt::format("the controller shows tag {}, not {}", e.receipt.tag_echo, tag));
    return;
  }
  s_.light_faults = 0;
  s_.refusals = 0;
  s_.has_shown = true;
  s_.receipt = e.receipt;
  if (s_.plan->sync == SyncMode::controller_leads) {
    s_.pulse_over_ns = e.receipt.t_shown_ns + kOpenTriggerNs;
  }
  s_.t_stable_ns = e.receipt.t_shown_ns + s_.plan->settle_ns;
  s_.step = t_ < s_.t_stable_ns ? ShotStep::settle : ShotStep::collect;
  s_.discarded = 0;
  s_.duplicates_before = s_.counters.duplicates;
  if (s_.plan->is_preview) {
    s_.shot_deadline_ns = t_ + kPreviewNs;
    drop_early();
    return;
  }
  const double frame_us =
      std::max(s_.plan->frame_us, shot_of(s_.current).exposure_us + s_.plan->skew_us);
  s_.shot_deadline_ns = std::max(t_, s_.t_stable_ns) + kShotSlackNs +
                        static_cast<std::int64_t>(kShotFrames * frame_us * 1e3);
  if (s_.plan->sync == SyncMode::light_leads) {
    s_.trigger_ns = next_trigger_ns();
  }
  // Their timestamps decide, not the order in which two threads reported.
  for (const SequencerState::TimestampedFrame& timestamped : std::exchange(s_.early, {})) {
    validate(timestamped);
  }
}

void Stepper::on(const event::LightConfirmed& e) {
  if (!s_.awaiting || s_.awaiting->frame != e.frame) {
    return;
  }
  SequencerState::Awaiting waiting = *std::move(s_.awaiting);
  s_.awaiting.reset();
  session::FrameEvidence& evidence = waiting.evidence;
  const session::CleanVerdict verdict =
      session::assess_clean({evidence.t_exposure_start_ns, evidence.t_exposure_end_ns},
                            evidence.t_stable_ns, e.t_request_ns);
  evidence.t_next_change_ns = e.t_request_ns;
  evidence.margin_us = verdict.margin_us;
  evidence.temperature_c = e.temperature_c;
  note_temperature(e.temperature_c, waiting.shot);
  if (e.tag == evidence.tag && e.boot_id == s_.boot_id && verdict.is_clean) {
    s_.held.push_back(SequencerState::Held{waiting.frame, waiting.shot, waiting.attempt});
    shot_state(waiting.shot) = ShotState::checking;
    out_.emplace_back(action::CheckFrame{waiting.frame, waiting.shot, waiting.attempt,
                                         std::move(waiting.evidence)});
    return;
  }
  ++s_.counters.confirms_failed;
  drop(waiting.frame);
  const bool is_newest = waiting.job == s_.job;
  if (is_newest) {
    s_.is_job_open = false;
    s_.pulse_over_ns = kNoPulse;  // nothing was latched
    leave_shot();                 // the light thread never showed it
  }
  const bool is_reboot = e.boot_id != s_.boot_id;
  retry(waiting.shot,
        is_reboot
            ? fmt::format("the controller started again (boot {})", e.boot_id)
            : fmt::format("the light changed by itself: tag {}, not {}", e.tag, evidence.tag));
  if (is_reboot) {
    lose_controller("the controller started again", t_, waiting.shot);
  } else if (is_newest) {
    s_.is_dark = false;  // unknown
    advance(std::nullopt);
  }
}

void Stepper::begin_shot(std::optional<ConfirmRequest> confirm) {
  const int shot = s_.pending.front();
  s_.pending.pop_front();
  s_.current = shot;
  s_.step = ShotStep::light;
  s_.shot_deadline_ns = kNever;
  shot_state(shot) = ShotState::exposing;
  const double exposure_us = shot_of(shot).exposure_us;
  if (exposure_us != s_.exposure_requested_us) {
    s_.exposure_requested_us = exposure_us;
    s_.is_exposure_open = true;
    out_.emplace_back(action::SetExposure{++s_.exposure_request, exposure_us});
  }
  s_.is_dark = false;
  s_.is_job_open = true;
  s_.waits_for_pulse = false;
  if (s_.plan->sync == SyncMode::controller_leads) {
    s_.pulse_over_ns = kNever;
  }
  out_.emplace_back(action::ShowShot{++s_.job, shot, shot_of(shot).tag, confirm});
}

bool Stepper::is_pulse_open() const {
  return s_.plan->sync == SyncMode::controller_leads && !s_.plan->is_preview &&
         t_ < s_.pulse_over_ns;
}

void Stepper::note_job_end() {
  if (s_.pulse_over_ns == kNever) {
    s_.pulse_over_ns = t_ + firmware_iface::kShownWithinNs + kOpenTriggerNs;
  }
}

void Stepper::return_to_pending(int shot) {
  shot_state(shot) = ShotState::pending;
  s_.pending.push_front(shot);
}

void Stepper::leave_shot() {
  leave_block();
  if (s_.current >= 0) {
    return_to_pending(s_.current);
  }
  s_.current = -1;
  s_.step = ShotStep::none;
  s_.shot_deadline_ns = kNever;
  s_.trigger_ns = kNever;
  drop_early();
}

void Stepper::retry(int shot, const std::string& why) {
  ++s_.counters.retries;
  ++s_.failures;
  log(session::EventKind::retry, why, shot);
  shot_state(shot) = ShotState::pending;
  if (is_by_strobe() || s_.failures % kFailuresToRotate == 0) {
    s_.pending.push_back(shot);
  } else {
    s_.pending.push_front(shot);
  }
  if (s_.failures >= kFailuresToSuspend && s_.phase == Phase::running) {
    s_.retry_evidence_ns = t_ + kEvidenceRetryNs;
    add_reason(kNoEvidence, "no clean frame: " + why, shot);
  }
}

void Stepper::on_shot_timeout() {
  s_.shot_deadline_ns = kNever;
  s_.trigger_ns = kNever;
  if (s_.phase == Phase::preflight) {
    s_.retry_evidence_ns = t_ + kEvidenceRetryNs;
    add_reason(kNoEvidence,
               fmt::format("camera: its frames' period is not known after {:.1f} s: too few "
                           "came undamaged, in order and with a timestamp that can be true",
                           1e-9 * static_cast<double>(rhythm_patience_ns())),
               -1);
    return;
  }
  if (is_block_armed()) {
    ++s_.counters.shot_timeouts;
    end_block("no strobe in time");
    return;
  }
  if (s_.current < 0) {
    return;
  }
  if (s_.plan->is_preview) {
    abort("the preview ends after a minute");
    return;
  }
  ++s_.counters.shot_timeouts;
  const int shot = s_.current;
  s_.current = -1;
  s_.step = ShotStep::none;
  const std::uint64_t n_same = s_.counters.duplicates - s_.duplicates_before;
  retry(shot,
        fmt::format(
            "no clean frame in time, {} discarded{}", s_.discarded,
            n_same == 0 ? "" : fmt::format(" ({} with the pixels of an earlier one)", n_same)));
  advance(std::nullopt);
}

void Stepper::validate(const SequencerState::TimestampedFrame& timestamped) {
  const event::FrameArrived& e = timestamped.frame;
  const bool is_collecting = s_.current >= 0 && !s_.awaiting &&
                             (s_.step == ShotStep::settle || s_.step == ShotStep::collect);
  if (is_collecting && t_ >= s_.t_stable_ns) {
    s_.step = ShotStep::collect;
  }
  if (s_.plan->is_preview) {
    drop(e.frame);
    return;
  }
  if (!is_collecting || !is_exposed_as_requested(e.info) || !accept(timestamped)) {
    ++s_.discarded;
    ++s_.counters.frames_unused;
    drop(e.frame);
    if (is_collecting) {
      ask_again(e);
    }
  }
}

void Stepper::ask_again(const event::FrameArrived& e) {
  if (s_.current < 0 || s_.phase != Phase::running) {
    return;
  }
  if (s_.plan->sync == SyncMode::light_leads) {
    s_.trigger_ns = next_trigger_ns();
  } else if (s_.plan->sync == SyncMode::controller_leads &&
             e.info.timestamp_ns > s_.receipt.t_command_ns) {
    const int shot = s_.current;
    s_.current = -1;
    s_.step = ShotStep::none;
    s_.shot_deadline_ns = kNever;
    retry(shot, "the triggered frame was not clean");
    advance(std::nullopt);
  }
}

std::int64_t Stepper::next_trigger_ns() const {
  // A timestamp early by its jitter casts no doubt on a frame begun this much later.
  const std::int64_t stable_ns = std::max(t_, s_.t_stable_ns + kGuardNs);
  return s_.triggered_ns == kNever ? stable_ns
                                   : std::max(stable_ns, s_.triggered_ns + kOpenTriggerNs);
}

void Stepper::drop_early() {
  for (const SequencerState::TimestampedFrame& timestamped : std::exchange(s_.early, {})) {
    drop(timestamped.frame.frame);
    ++s_.counters.frames_unused;
  }
}

std::int64_t Stepper::earliest_start_ns() const {
  switch (s_.plan->sync) {
    case SyncMode::light_leads:
      return s_.trigger_ns != kNever ? kNever : s_.triggered_ns - kGuardNs;
    case SyncMode::controller_leads:
      // The latch acts after its command and sends the pulse; its timer has a clock of its own.
      return s_.receipt.t_command_ns + s_.plan->trigger_delay_ns - kGuardNs;
    case SyncMode::free_run:
    case SyncMode::camera_leads:
      break;
  }
  return std::numeric_limits<std::int64_t>::min();
}

bool Stepper::accept(const SequencerState::TimestampedFrame& timestamped) {
  const event::FrameArrived& e = timestamped.frame;
  const SequencerPlan& plan = *s_.plan;
  const SequencedShot& shot = shot_of(s_.current);
  const session::ExposureWindow window =
      session::exposure_window({.timestamp_ns = e.info.timestamp_ns,
                                .meaning = plan.timestamp,
                                .exposure_us = e.info.exposure_us,
                                .read_us = plan.read_us,
                                .skew_us = plan.skew_us});
  // The settle time includes one guard; timestamps that scatter more need more.
  const std::int64_t t_stable_ns =
      s_.t_stable_ns + std::max<std::int64_t>(timestamped.guard_ns - kGuardNs, 0);
  if (!session::assess_clean(window, t_stable_ns, t_).is_clean ||
      window.start_ns < earliest_start_ns()) {
    return false;
  }
  session::FrameEvidence evidence = describe_frame(e, s_.current, window);
  evidence.tag_echo = s_.receipt.tag_echo;
  evidence.is_read_back = s_.receipt.proof == firmware_iface::LightProof::read_back;
  evidence.t_command_ns = s_.receipt.t_command_ns;
  evidence.t_ack_ns = s_.receipt.t_ack_ns;
  evidence.t_shown_ns = s_.receipt.t_shown_ns;
  evidence.t_stable_ns = t_stable_ns;
  const int i_shot = s_.current;
  const int attempt = s_.attempts[static_cast<std::size_t>(i_shot)]++;
  s_.current = -1;
  s_.step = ShotStep::none;
  s_.shot_deadline_ns = kNever;
  s_.trigger_ns = kNever;
  s_.triggered_ns = kNever;
  s_.pulse_over_ns = kNoPulse;
  // The job that confirms this frame is the next one that advance() issues.
  s_.awaiting =
      SequencerState::Awaiting{e.frame, s_.job + 1, i_shot, attempt, std::move(evidence)};
  advance(ConfirmRequest{e.frame, shot.tag});
  return true;
}

session::FrameEvidence Stepper::describe_frame(const event::FrameArrived& e, int shot,
                                               const session::ExposureWindow& window) const {
  const SequencerPlan& plan = *s_.plan;
  session::FrameEvidence evidence;
  evidence.pattern_id = shot_of(shot).pattern_id;
  evidence.tag = shot_of(shot).tag;
  evidence.t_exposure_start_ns = window.start_ns;
  evidence.t_exposure_end_ns = window.end_ns;
  evidence.sequence = e.info.sequence;
  evidence.timestamp_ns = e.info.timestamp_ns;
  evidence.timestamp_meaning = plan.timestamp;
  evidence.flags = e.info.flags;
  evidence.exposure_requested_us = shot_of(shot).exposure_us;
  evidence.exposure_read_us = e.info.exposure_us;
  evidence.gain_db = e.info.gain_db;
  evidence.read_us = plan.read_us;
  evidence.skew_us = plan.skew_us;
  evidence.discarded_before = s_.discarded;
  evidence.sync = plan.sync;
  return evidence;
}

}  // namespace haarlight::capture
