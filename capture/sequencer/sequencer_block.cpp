// SPDX-License-Identifier: Apache-2.0
/// @file
/// The sequencer where the camera leads: its strobe steps a previously uploaded table, in
/// blocks no longer than the free buffers. What a frame saw follows from the step counter's
/// readings (strobe_proof.h). A block is extended while it runs; with a slow disk it is not,
/// ends early in the dark, and the next one begins after it: no frame is lost.

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "capture/sequencer/stepper.h"
#include "session/clean_rule.h"

namespace haarlight::capture {

using namespace sequencing;

namespace {

constexpr std::size_t kMaxReadings = 1024;
constexpr int kWorthARun = 8;  // a shorter remainder of the old table is not worth a block

/// What keeps a controller from lighting anything for now; empty: nothing it reports.
std::string cause_of_holding_back(std::uint32_t faults) {
  if ((faults & firmware_iface::registers::kFaultInterlock) != 0) {
    return "the interlock is open";
  }
  if ((faults & firmware_iface::registers::kFaultOverTemperature) != 0) {
    return "the board is too hot";
  }
  return (faults & firmware_iface::registers::kFaultElementDuty) != 0
             ? "an element is beyond its thermal duty"
             : "";
}

}  // namespace

bool Stepper::is_by_strobe() const {
  return s_.plan != nullptr && s_.plan->sync == SyncMode::camera_leads && !s_.plan->is_preview;
}

bool Stepper::is_block_armed() const {
  return s_.block.step == SequencerState::Block::Step::running ||
         s_.block.step == SequencerState::Block::Step::arming;
}

StrobeTiming Stepper::strobe_timing() const {
  const auto period_ns = static_cast<std::int64_t>(std::llround(s_.plan->frame_us * 1e3));
  return {.period_ns = period_ns,
          .settle_ns = s_.plan->settle_ns,
          .guard_ns = strobe_guard_ns(period_ns),
          .every = s_.plan->strobe_every};
}

std::int64_t Stepper::block_patience_ns() const {
  const double frames = kShotFrames * s_.plan->strobe_every;
  return kShotSlackNs + static_cast<std::int64_t>(frames * s_.plan->frame_us * 1e3);
}

int Stepper::shot_under_way() const {
  const SequencerState::Block& b = s_.block;
  const bool is_stepped = is_block_armed() && b.counter >= 1 && b.counter <= b.shots.size();
  return is_stepped ? b.shots[b.counter - 1] : s_.current;
}

int Stepper::block_capacity() const { return std::max(1, s_.n_buffers - kSpareBuffers); }

int Stepper::block_credit() const {
  const SequencerState::Block& b = s_.block;
  const int n_open = is_block_armed() ? b.n_armed - b.n_decided : 0;
  return std::max(0, block_capacity() - n_open - static_cast<int>(s_.held.size()));
}

int Stepper::n_alike_pending() const {
  const int most = std::min<int>(static_cast<int>(s_.pending.size()),
                                 std::min(s_.plan->table_depth, s_.table_depth));
  int n = 0;
  while (n < most && shot_of(s_.pending[static_cast<std::size_t>(n)]).exposure_us ==
                         shot_of(s_.pending.front()).exposure_us) {
    ++n;
  }
  return n;
}

void Stepper::advance_block() {
  if (s_.phase != Phase::running) {
    return;
  }
  using enum SequencerState::Block::Step;
  switch (s_.block.step) {
    case running:
      extend_block();
      return;
    case exposing:
    case uploading:
    case arming:
      return;
    case none:
      break;
  }
  if (is_rhythm_missing()) {
    preflight();
  } else if (!s_.pending.empty()) {
    begin_block();
  } else if (!s_.is_dark) {
    lights_off(std::nullopt);
  } else if (s_.n_committed == static_cast<int>(s_.shots.size())) {
    enter(Phase::finalise, "all shots are committed");
    out_.emplace_back(action::FinishSession{});
  }
}

/// The exposure is set first and confirmed in a frame before anything is armed with it: a
/// barrier.
void Stepper::begin_block() {
  if (s_.table_depth < 1) {
    abort("controller: it has no pattern table that the camera could step");
    return;
  }
  // Not for every single buffer that the disk returns: a block costs some frames.
  if (block_credit() < std::max(1, block_capacity() / 2) && !s_.held.empty()) {
    if (!s_.is_dark) {
      lights_off(std::nullopt);
    }
    return;
  }
  draw_dark();
  const double exposure_us = shot_of(s_.pending.front()).exposure_us;
  if (exposure_us != s_.exposure_requested_us) {
    s_.exposure_requested_us = exposure_us;
    s_.is_exposure_open = true;
    s_.is_exposure_seen = false;
    out_.emplace_back(action::SetExposure{++s_.exposure_request, exposure_us});
  }
  SequencerState::Block& b = s_.block;
  const int n_alike = n_alike_pending();
  const auto at = std::find(b.table.begin(), b.table.end(), s_.pending.front());
  int n_run = 0;
  while (n_run < n_alike && at + n_run != b.table.end() &&
         *(at + n_run) == s_.pending[static_cast<std::size_t>(n_run)]) {
    ++n_run;
  }
  if (at == b.table.end() || n_run < std::min(n_alike, kWorthARun)) {
    upload_block(n_alike);
    return;
  }
  b.first = static_cast<int>(at - b.table.begin());
  b.step = SequencerState::Block::Step::exposing;
  arm_block();
}

void Stepper::upload_block(int n_shots) {
  SequencerState::Block& b = s_.block;
  b.table.assign(s_.pending.begin(), s_.pending.begin() + n_shots);
  b.step = SequencerState::Block::Step::uploading;
  std::vector<std::uint32_t> tags;
  tags.reserve(b.table.size());
  for (const int shot : b.table) {
    tags.push_back(shot_of(shot).tag);
  }
  s_.is_job_open = true;
  out_.emplace_back(action::UploadTable{++s_.job, b.table, std::move(tags)});
}

void Stepper::on(const event::TableUploaded& e) {
  SequencerState::Block& b = s_.block;
  if (e.job != s_.job) {
    return;
  }
  s_.is_job_open = false;
  if (b.step != SequencerState::Block::Step::uploading) {
    return;
  }
  s_.light_faults = 0;
  b.first = 0;
  b.step = SequencerState::Block::Step::exposing;
  arm_block();
}

void Stepper::take_pending(int n_most) {
  SequencerState::Block& b = s_.block;
  for (; n_most > 0 && !s_.pending.empty(); --n_most) {
    const auto next = static_cast<std::size_t>(b.first) + static_cast<std::size_t>(b.n_armed);
    if (s_.pending.front() != b.table[next]) {
      return;
    }
    shot_state(s_.pending.front()) = ShotState::exposing;
    b.shots.push_back(s_.pending.front());
    s_.pending.pop_front();
    ++b.n_armed;
  }
}

void Stepper::arm_block() {
  SequencerState::Block& b = s_.block;
  if (b.step != SequencerState::Block::Step::exposing || !s_.is_exposure_seen) {
    return;
  }
  const int n_left = static_cast<int>(b.table.size()) - b.first;
  b.n_armed = 0;
  b.shots.clear();
  take_pending(std::clamp(block_credit(), 1, n_left));
  if (b.n_armed == 0) {  // something else was queued ahead meanwhile
    b.step = SequencerState::Block::Step::none;
    advance_block();
    return;
  }
  b.is_decided.assign(static_cast<std::size_t>(b.n_armed), false);
  b.n_decided = 0;
  b.n_accepted = 0;
  b.counter = 0;
  b.done_ns = kNever;
  b.readings.clear();
  b.step = SequencerState::Block::Step::arming;
  ++s_.counters.blocks;
  s_.is_dark = false;
  s_.is_job_open = true;
  b.job = ++s_.job;
  out_.emplace_back(action::ArmBlock{b.job, b.first, b.n_armed, s_.plan->strobe_every});
}

void Stepper::on(const event::BlockArmed& e) {
  SequencerState::Block& b = s_.block;
  if (e.job != b.job || b.step != SequencerState::Block::Step::arming) {
    return;
  }
  s_.is_job_open = false;
  s_.light_faults = 0;
  s_.refusals = 0;
  s_.has_shown = true;
  b.step = SequencerState::Block::Step::running;
  b.armed = e.receipt;
  s_.discarded = 0;
  s_.shot_deadline_ns = t_ + block_patience_ns();
}

void Stepper::extend_block() {
  SequencerState::Block& b = s_.block;
  if (b.done_ns != kNever || dark_due()) {
    return;
  }
  const int n_left = static_cast<int>(b.table.size()) - b.first - b.n_armed;
  const int n_more = std::min(block_credit(), n_left);
  // Few exchanges, but never so few that the table runs dry.
  const bool is_near_end = b.n_armed - static_cast<int>(b.counter) <= 2;
  if (n_more < 1 || (n_more < std::min(4, n_left) && !is_near_end)) {
    return;
  }
  const int before = b.n_armed;
  take_pending(n_more);
  b.is_decided.resize(static_cast<std::size_t>(b.n_armed), false);
  if (b.n_armed > before) {
    out_.emplace_back(action::ExtendBlock{b.job, b.n_armed});
  }
}

void Stepper::on(const event::StepRead& e) {
  SequencerState::Block& b = s_.block;
  if (e.job != b.job || b.step != SequencerState::Block::Step::running) {
    return;
  }
  if (e.boot_id != s_.boot_id) {
    const int shot = shot_under_way();
    leave_block();
    lose_controller(fmt::format("the controller started again (boot {})", e.boot_id), t_, shot);
    return;
  }
  if (!e.is_armed) {
    ++s_.counters.confirms_failed;
    s_.is_dark = false;  // unknown
    if (const std::string cause = cause_of_holding_back(e.faults); !cause.empty()) {
      const int shot = shot_under_way();
      leave_block();
      s_.retry_held_ns = t_ + kHeldRetryNs;
      add_reason(kHeldBack, "controller: the table was disarmed: " + cause, shot);
      return;
    }
    end_block("the table was disarmed: lease, interlock or another host");
    return;
  }
  b.temperature_c = e.temperature_c;
  b.readings.push_back({e.t_request_ns, e.t_ack_ns, e.step_counter, e.tag});
  if (b.readings.size() > kMaxReadings) {
    b.readings.pop_front();
  }
  const bool is_of_table = e.step_counter >= 1 && !e.is_done &&
                           e.step_counter <= static_cast<std::uint32_t>(b.n_armed);
  if (is_of_table) {
    if (e.tag != shot_of(b.shots[e.step_counter - 1]).tag) {
      on_table_mismatch(e.step_counter, e.tag);
      return;
    }
  }
  if (e.step_counter != b.counter) {
    b.counter = e.step_counter;
    if (b.done_ns == kNever) {
      s_.shot_deadline_ns = t_ + block_patience_ns();
    }
  }
  if (e.is_done && b.done_ns == kNever) {
    b.done_ns = e.t_ack_ns;
  }
  decide_block();
}

void Stepper::on_table_mismatch(std::uint32_t counter, std::uint32_t tag) {
  ++s_.counters.table_mismatches;
  s_.block.table.clear();  // upload it again
  end_block(fmt::format("at step {} the controller shows tag {}, another one than its table's",
                        counter, tag));
}

void Stepper::take_block_frame(const event::FrameArrived& e) {
  SequencerState::Block& b = s_.block;
  if (!is_exposed_as_requested(e.info)) {
    ++s_.counters.frames_unused;
    drop(e.frame);
    return;
  }
  s_.is_exposure_seen = true;
  const bool is_wanted = is_block_armed() && s_.phase == Phase::running;
  const session::ExposureWindow window =
      session::exposure_window({.timestamp_ns = e.info.timestamp_ns,
                                .meaning = s_.plan->timestamp,
                                .exposure_us = e.info.exposure_us,
                                .read_us = s_.plan->read_us,
                                .skew_us = s_.plan->skew_us});
  const bool is_before =
      b.step == SequencerState::Block::Step::running && window.end_ns < b.armed.t_command_ns;
  const bool is_past = window.start_ns > b.done_ns;
  if (!is_wanted || is_before || is_past) {
    ++s_.counters.frames_unused;
    drop(e.frame);
  } else {
    b.waiting.push_back({e, window});
  }
  if (b.step == SequencerState::Block::Step::exposing && s_.phase == Phase::running) {
    arm_block();
  } else if (b.step == SequencerState::Block::Step::running) {
    decide_block();
    if (b.step == SequencerState::Block::Step::running && is_past && b.waiting.empty()) {
      end_block("");  // frames arrive in order: no other one saw the table
    }
  }
}

void Stepper::decide_block() {
  SequencerState::Block& b = s_.block;
  const std::uint64_t job = b.job;
  const StrobeTiming timing = strobe_timing();
  while (!b.waiting.empty()) {
    StrobeProof proof = prove_by_strobe(b.readings, b.waiting.front().window, timing);
    if (proof.verdict == StrobeVerdict::wait) {
      break;
    }
    const SequencerState::Block::Waiting waiting = b.waiting.front();
    b.waiting.pop_front();
    if (proof.verdict == StrobeVerdict::unproven) {
      ++s_.counters.strobe_unproven;
      ++s_.counters.frames_unused;
      ++s_.discarded;
      drop(waiting.frame.frame);
    } else {
      take_by_strobe(waiting.frame, waiting.window, proof);
    }
  }
  if (b.step != SequencerState::Block::Step::running || b.job != job) {
    return;
  }
  if (b.done_ns != kNever && b.n_decided == b.n_armed) {
    end_block("");
  } else {
    extend_block();
  }
}

void Stepper::take_by_strobe(const event::FrameArrived& e,
                             const session::ExposureWindow& window, const StrobeProof& proof) {
  SequencerState::Block& b = s_.block;
  const auto k = static_cast<int>(
      std::min<std::uint32_t>(proof.counter, static_cast<std::uint32_t>(b.n_armed) + 1));
  const int entry = k - 1;
  const bool is_of_table =
      k >= 1 && k <= b.n_armed && !b.is_decided[static_cast<std::size_t>(entry)];
  const int shot = is_of_table ? b.shots[static_cast<std::size_t>(entry)] : -1;
  if (!is_of_table || proof.tag != shot_of(shot).tag) {
    ++s_.counters.frames_unused;  // dark before the first or after the last step
    drop(e.frame);
    return;
  }
  session::FrameEvidence evidence = describe_frame(e, shot, window);
  evidence.tag_echo = proof.tag;
  evidence.t_command_ns = b.armed.t_command_ns;
  evidence.t_ack_ns = b.armed.t_ack_ns;
  evidence.t_shown_ns = proof.t_shown_ns;
  evidence.t_stable_ns = proof.t_stable_ns;
  evidence.t_next_change_ns = window.end_ns;  // the strobe itself
  evidence.temperature_c = b.temperature_c;
  note_temperature(b.temperature_c, shot);
  evidence.step_before = proof.counter;
  evidence.step_after = std::int64_t{proof.counter} + 1;
  evidence.margin_us = 1e-3 * static_cast<double>(window.start_ns - proof.t_stable_ns);
  s_.discarded = 0;
  ++b.n_accepted;
  const int attempt = s_.attempts[static_cast<std::size_t>(shot)]++;
  s_.held.push_back(SequencerState::Held{e.frame, shot, attempt});
  shot_state(shot) = ShotState::checking;
  decide(entry);
  // Entries passed without a proven frame are shown again later.
  for (int i = 0; i < entry; ++i) {
    if (!b.is_decided[static_cast<std::size_t>(i)]) {
      const int lost = b.shots[static_cast<std::size_t>(i)];
      shot_state(lost) = ShotState::pending;
      s_.pending.push_back(lost);
      ++s_.counters.retries;
      decide(i);
    }
  }
  out_.emplace_back(action::CheckFrame{e.frame, shot, attempt, std::move(evidence)});
}

void Stepper::decide(int entry) {
  s_.block.is_decided[static_cast<std::size_t>(entry)] = true;
  ++s_.block.n_decided;
}

void Stepper::end_block(const std::string& why) {
  SequencerState::Block& b = s_.block;
  const bool is_cut = b.done_ns != kNever && !s_.pending.empty() && !b.table.empty() &&
                      b.first + b.n_armed < static_cast<int>(b.table.size());
  s_.counters.blocks_cut += is_cut ? 1 : 0;
  release_waiting();
  s_.shot_deadline_ns = kNever;
  if (!why.empty()) {
    log(session::EventKind::retry, why);
  }
  const int n_open = b.n_armed - b.n_decided;
  s_.counters.retries += static_cast<std::uint64_t>(n_open);
  return_entries(false);
  if (b.n_accepted == 0) {
    ++s_.failures;
    if (s_.failures >= kBlocksToSuspend && s_.phase == Phase::running) {
      s_.retry_evidence_ns = t_ + kEvidenceRetryNs;
      add_reason(
          kNoEvidence,
          "no frame proved by the strobe: " + (why.empty() ? "steps were lost or false" : why),
          -1);
    }
  }
  advance(std::nullopt);
}

void Stepper::leave_block() {
  SequencerState::Block& b = s_.block;
  release_waiting();
  if (b.step == SequencerState::Block::Step::uploading) {
    b.table.clear();
  }
  if (is_block_armed()) {
    s_.shot_deadline_ns = kNever;
    return_entries(true);
  }
  b.step = SequencerState::Block::Step::none;
}

void Stepper::release_waiting() {
  for (const SequencerState::Block::Waiting& waiting : std::exchange(s_.block.waiting, {})) {
    ++s_.counters.frames_unused;
    drop(waiting.frame.frame);
  }
}

void Stepper::return_entries(bool is_first) {
  SequencerState::Block& b = s_.block;
  std::deque<int> returned;
  for (int i = 0; i < b.n_armed; ++i) {
    if (!b.is_decided[static_cast<std::size_t>(i)]) {
      const int shot = b.shots[static_cast<std::size_t>(i)];
      shot_state(shot) = ShotState::pending;
      returned.push_back(shot);
    }
  }
  s_.pending.insert(is_first ? s_.pending.begin() : s_.pending.end(), returned.begin(),
                    returned.end());
  b.step = SequencerState::Block::Step::none;
}

}  // namespace haarlight::capture
