// SPDX-License-Identifier: Apache-2.0
/// @file
/// The sequencer: phases, operator requests, and the single step.

#include "capture/sequencer/sequencer.h"

#include <algorithm>
#include <cmath>
#include <iterator>

#include <fmt/format.h>

#include "capture/sequencer/stepper.h"

namespace haarlight::capture {

using namespace sequencing;

void Stepper::on(const event::Tick&) {
  if (due(s_.retry_light_ns)) {
    connect_light();
  }
  if (due(s_.retry_camera_ns)) {
    start_camera();
  }
  if (due(s_.retry_disk_ns)) {
    if (s_.phase == Phase::finalise) {
      out_.emplace_back(action::FinishSession{});
    } else {
      out_.emplace_back(action::RetryCommits{});
    }
  }
  if (due(s_.retry_evidence_ns)) {
    s_.failures = 0;
    clear_reason(kNoEvidence);
  }
  if (due(s_.retry_held_ns)) {
    clear_reason(kHeldBack);
  }
  if (due(s_.retry_wrong_light_ns)) {
    clear_reason(kWrongLight);
  }
  if (due(s_.trigger_ns) && s_.phase == Phase::running && s_.current >= 0) {
    s_.triggered_ns = t_;
    out_.emplace_back(action::TriggerCamera{});
  }
  if (s_.waits_for_pulse && s_.pulse_over_ns <= t_) {
    s_.waits_for_pulse = false;
    advance(std::nullopt);
  }
  if (s_.shot_deadline_ns <= t_) {
    on_shot_timeout();
  }
  if (s_.phase == Phase::aborting) {
    finish_abort();
  }
}

void Stepper::on(const event::Booted&) {
  if (s_.phase == Phase::boot) {
    enter(Phase::recover, "looking for unfinished sessions");
  }
}

void Stepper::on(const event::Recovered&) {
  if (s_.phase == Phase::recover) {
    enter(Phase::idle, "ready");
  }
}

void Stepper::on(const event::Run& run) {
  const bool is_free =
      s_.phase == Phase::idle || s_.phase == Phase::done || s_.phase == Phase::safe_off;
  if (!is_free || run.plan == nullptr || run.plan->shots.empty() ||
      run.committed.size() != run.plan->shots.size() ||
      run.next_attempt.size() != run.plan->shots.size()) {
    return;
  }
  release_all_frames();
  s_.plan = run.plan;
  s_.shots.assign(run.plan->shots.size(), ShotState::pending);
  s_.attempts = run.next_attempt;
  s_.pending.clear();
  s_.n_committed = 0;
  for (std::size_t i = 0; i < run.committed.size(); ++i) {
    if (run.committed[i]) {
      s_.shots[i] = ShotState::committed;
      ++s_.n_committed;
    } else {
      s_.pending.push_back(static_cast<int>(i));
    }
  }
  s_.is_finished = false;
  s_.failures = 0;
  s_.refusals = 0;
  s_.has_shown = false;
  s_.times_doubted.clear();
  s_.withdrawn.clear();
  s_.doubted.clear();
  if (s_.phase == Phase::safe_off) {
    log(session::EventKind::state, "safe-off: the run waits for the operator");
  } else {
    preflight();
  }
}

void Stepper::on(const event::Pause&) {
  if (is_shooting()) {
    enter(Phase::paused, "by the operator");
    leave_shot();
    darken();
  }
}

void Stepper::on(const event::Resume&) {
  if (s_.phase == Phase::safe_off && (s_.plan == nullptr || s_.is_finished)) {
    enter(Phase::idle, "by the operator");
  } else if (s_.phase == Phase::safe_off || s_.phase == Phase::paused) {
    preflight();
  }
}

void Stepper::on(const event::Abort&) {
  const bool has_run = is_shooting() || s_.phase == Phase::paused ||
                       s_.phase == Phase::finalise ||
                       (s_.phase == Phase::safe_off && s_.plan != nullptr);
  if (has_run) {
    abort("by the operator");
  }
}

void Stepper::on(const event::SafeOff&) {
  if (s_.phase == Phase::finalise || s_.phase == Phase::aborting || s_.phase == Phase::boot ||
      s_.phase == Phase::recover) {
    darken_always();  // these end by themselves, with the lights off
    return;
  }
  if (s_.phase != Phase::safe_off) {
    enter(Phase::safe_off, "all lights off by request");
  }
  leave_shot();
  darken_always();
}

void Stepper::on(const event::Reshoot& reshoot) {
  if (s_.plan == nullptr || s_.plan->is_preview || s_.phase == Phase::aborting ||
      s_.phase == Phase::finalise) {
    return;
  }
  if (!withdraw(reshoot.shots)) {
    return;
  }
  if (s_.phase == Phase::done) {
    s_.is_finished = false;
    preflight();
  } else {
    advance(std::nullopt);
  }
}

bool Stepper::withdraw(const std::vector<int>& shots) {
  std::vector<int> withdrawn;
  for (const int shot : shots) {
    if (shot < 0 || shot >= static_cast<int>(s_.shots.size()) ||
        shot_state(shot) != ShotState::committed) {
      continue;
    }
    shot_state(shot) = ShotState::pending;
    // Inserted among those already waiting: in a different order than before, so that they
    // follow different lights.
    const auto again = std::find_if(s_.pending.begin(), s_.pending.end(),
                                    [this](int s) { return s_.withdrawn.count(s) > 0; });
    s_.pending.insert(again + (s_.pending.end() - again) / 2, shot);
    s_.withdrawn.insert(shot);
    --s_.n_committed;
    withdrawn.push_back(shot);
  }
  if (withdrawn.empty()) {
    return false;
  }
  out_.emplace_back(action::WithdrawShots{std::move(withdrawn)});
  return true;
}

void Stepper::withdraw_doubted() {
  std::vector<int> shots;
  for (const int shot : s_.doubted) {
    if (shot_state(shot) == ShotState::committed) {
      shots.push_back(shot);
    }
  }
  for (const int shot : shots) {
    s_.doubted.erase(shot);
    ++s_.counters.frames_doubted;
    log(session::EventKind::retry, "its picture is contradicted by another one", shot);
    if (++s_.times_doubted[shot] >= kWrongLightsToSuspend) {
      s_.times_doubted.erase(shot);
      suspend_for_light("its picture contradicts that of another frame of its lights", shot);
    }
  }
  withdraw(shots);
}

void Stepper::close_step() {
  if (s_.phase == Phase::aborting) {
    finish_abort();
  }
  s_.deadline_ns =
      std::min({s_.retry_light_ns, s_.retry_camera_ns, s_.retry_disk_ns, s_.retry_evidence_ns,
                s_.retry_held_ns, s_.retry_wrong_light_ns, s_.shot_deadline_ns, s_.trigger_ns,
                s_.abort_deadline_ns, s_.waits_for_pulse ? s_.pulse_over_ns : kNever});
}

std::vector<SequencerState::Held>::iterator Stepper::find_held(std::uint64_t frame) {
  return std::find_if(s_.held.begin(), s_.held.end(),
                      [frame](const SequencerState::Held& h) { return h.frame == frame; });
}

bool Stepper::is_shooting() const {
  return s_.phase == Phase::preflight || s_.phase == Phase::running ||
         s_.phase == Phase::suspended;
}

bool Stepper::due(std::int64_t& deadline_ns) const {
  if (deadline_ns > t_) {
    return false;
  }
  deadline_ns = kNever;
  return true;
}

void Stepper::log(session::EventKind kind, std::string text, int shot) {
  out_.emplace_back(action::LogEvent{kind, std::move(text), shot});
}

void Stepper::enter(Phase phase, const std::string& why) {
  s_.phase = phase;
  log(session::EventKind::state, fmt::format("{}: {}", to_string(phase), why));
}

void Stepper::preflight() {
  s_.phase = Phase::preflight;
  log(session::EventKind::state, "preflight");
  prepare();
}

void Stepper::prepare() {
  if (!s_.is_light_connected) {
    if (!s_.is_job_open) {
      connect_light();
    }
  } else if (!s_.is_camera_started && !s_.is_camera_starting) {
    start_camera();
  }
  preflight_done();
}

void Stepper::preflight_done() {
  if (s_.reasons != 0) {
    enter(Phase::suspended, reasons_text(s_.reasons));
  } else if (s_.is_light_connected && s_.is_camera_started && is_rhythm_missing()) {
    darken();
    if (s_.shot_deadline_ns == kNever) {
      s_.shot_deadline_ns = t_ + rhythm_patience_ns();
    }
  } else if (s_.is_light_connected && s_.is_camera_started) {
    s_.shot_deadline_ns = kNever;
    s_.reason_text.clear();
    enter(Phase::running,
          fmt::format("{} of {} shots to do", s_.pending.size(), s_.shots.size()));
    advance(std::nullopt);
  }
}

void Stepper::advance(std::optional<ConfirmRequest> confirm) {
  if (is_by_strobe()) {
    advance_block();
    return;
  }
  if (s_.phase != Phase::running || s_.current >= 0) {
    if (confirm) {
      lights_off(confirm);
    }
    return;
  }
  const bool has_room = static_cast<int>(s_.held.size()) + (s_.awaiting ? 1 : 0) < s_.max_held;
  if (has_room && is_rhythm_missing()) {
    if (confirm) {
      lights_off(confirm);
    }
    preflight();
  } else if (has_room && !s_.pending.empty() && is_pulse_open()) {
    s_.waits_for_pulse = true;
    if (confirm || !s_.is_dark) {
      lights_off(confirm);
    }
  } else if (has_room && !s_.pending.empty()) {
    draw_dark();
    begin_shot(confirm);
  } else if (confirm || !s_.is_dark) {
    lights_off(confirm);
  } else if (s_.n_committed == static_cast<int>(s_.shots.size())) {
    enter(Phase::finalise, "all shots are committed");
    out_.emplace_back(action::FinishSession{});
  }
}

void Stepper::note_temperature(std::optional<double> temperature_c, int shot) {
  s_.temperature_c = temperature_c;
  if (shot_of(shot).is_dark) {
    s_.dark_temperature_c = temperature_c;
  }
}

std::optional<int> Stepper::dark_due() const {
  if (s_.plan->darks_every_c <= 0.0 || !s_.temperature_c || !s_.dark_temperature_c ||
      std::abs(*s_.temperature_c - *s_.dark_temperature_c) < s_.plan->darks_every_c ||
      s_.pending.empty() || shot_of(s_.pending.front()).is_dark) {
    return std::nullopt;
  }
  const double exposure_us = shot_of(s_.pending.front()).exposure_us;
  const auto is_dark_alike = [&](int shot) {
    return shot_of(shot).is_dark && shot_of(shot).exposure_us == exposure_us;
  };
  const auto end = s_.pending.rend();
  const auto last = std::find_if(s_.pending.rbegin(), end, is_dark_alike);
  if (last == end) {
    return std::nullopt;
  }
  const auto spare = std::find_if(std::next(last), end, is_dark_alike);
  return spare == end ? std::nullopt : std::optional<int>(*spare);
}

void Stepper::draw_dark() {
  const std::optional<int> dark = dark_due();
  if (!dark) {
    return;
  }
  log(session::EventKind::dark,
      fmt::format("{:.1f} degrees C, {:.1f} at the last dark frame: shot {} comes now",
                  *s_.temperature_c, *s_.dark_temperature_c, *dark));
  s_.pending.erase(std::find(s_.pending.begin(), s_.pending.end(), *dark));
  s_.pending.push_front(*dark);
  s_.dark_temperature_c = s_.temperature_c;  // until this one is taken
}

void Stepper::add_reason(std::uint32_t reason, const std::string& text, int shot) {
  if ((s_.reasons & reason) == 0) {
    log(session::EventKind::fault, text, shot);
  }
  s_.reasons |= reason;
  s_.reason_text = text;
  if (s_.phase == Phase::running || s_.phase == Phase::preflight) {
    ++s_.counters.suspensions;
    leave_shot();
    enter(Phase::suspended, reasons_text(s_.reasons));
    darken();
  }
}

void Stepper::clear_reason(std::uint32_t reason) {
  s_.reasons &= ~reason;
  if (s_.reasons == 0 && s_.phase == Phase::suspended) {
    preflight();
  }
}

void Stepper::became_ready(std::uint32_t reason) {
  const bool was_preflight = s_.phase == Phase::preflight;
  clear_reason(reason);
  if (was_preflight && s_.phase == Phase::preflight) {
    prepare();
  }
}

void Stepper::abort(const std::string& why) {
  if (s_.phase == Phase::idle || s_.phase == Phase::done || s_.phase == Phase::aborting) {
    return;
  }
  s_.reason_text = why;
  enter(Phase::aborting, why);
  if (s_.plan != nullptr && !s_.plan->is_preview) {
    out_.emplace_back(action::MarkAborted{why});
  }
  leave_shot();
  s_.abort_deadline_ns = t_ + kAbortLimitNs;
  darken();
}

void Stepper::finish_abort() {
  const bool is_over = t_ >= s_.abort_deadline_ns;
  const bool is_quiet = !s_.is_job_open && s_.held.empty() && !s_.awaiting;
  if (!is_over && !is_quiet) {
    return;
  }
  if (!s_.held.empty()) {
    out_.emplace_back(action::ForgetCommits{});
  }
  release_all_frames();
  stop_camera();
  if (s_.is_job_open) {
    s_.is_light_connected = false;  // no answer: reconnecting turns the lights off
    s_.is_job_open = false;
  }
  s_.plan.reset();
  s_.pending.clear();
  s_.reasons = 0;
  s_.failures = 0;
  s_.retry_light_ns = s_.retry_camera_ns = s_.retry_disk_ns = s_.retry_evidence_ns =
      s_.retry_held_ns = s_.retry_wrong_light_ns = kNever;
  s_.times_doubted.clear();
  s_.withdrawn.clear();
  s_.doubted.clear();
  s_.abort_deadline_ns = kNever;
  enter(Phase::idle, "aborted");
}

void Stepper::release_all_frames() {
  for (const SequencerState::Held& held : s_.held) {
    drop(held.frame);
  }
  s_.held.clear();
  if (s_.awaiting) {
    drop(s_.awaiting->frame);
    s_.awaiting.reset();
  }
}

StepResult step(SequencerState state, const TimedEvent& event) {
  StepResult result{std::move(state), {}};
  Stepper stepper(result.state, event.t_ns, result.actions);
  std::visit([&stepper](const auto& body) { stepper.on(body); }, event.body);
  stepper.close_step();
  return result;
}

}  // namespace haarlight::capture
