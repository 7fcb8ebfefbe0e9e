// SPDX-License-Identifier: Apache-2.0
/// @file
/// The sequencer: checks and commits.

#include <fmt/format.h>

#include "capture/sequencer/stepper.h"

namespace haarlight::capture {

using namespace sequencing;

void Stepper::on(const event::FrameChecked& e) {
  const auto it = find_held(e.frame);
  if (it == s_.held.end()) {
    return;
  }
  if (!e.note.empty()) {
    log(session::EventKind::light, e.note, e.shot);
  }
  s_.doubted.insert(e.doubted.begin(), e.doubted.end());
  if (e.problem.empty()) {
    if (shot_state(it->shot) == ShotState::checking) {
      shot_state(it->shot) = ShotState::committing;
      out_.emplace_back(action::CommitFrame{it->frame, it->shot, it->attempt, e.evidence});
    }
    withdraw_doubted();
    return;
  }
  ++s_.counters.checks_failed;  // also reported by the writer, which validates once more
  const int shot = it->shot;
  s_.held.erase(it);
  drop(e.frame);
  retry(shot, e.problem);
  withdraw_doubted();
  advance(std::nullopt);
}

void Stepper::suspend_for_light(const std::string& problem, int shot) {
  if (s_.phase != Phase::running) {
    return;
  }
  s_.retry_wrong_light_ns = t_ + kWrongLightRetryNs;
  add_reason(
      kWrongLight,
      fmt::format("twice not the picture of its light: {}. Does the controller act late, "
                  "is an LED wired to another's output, or was something moved? Tried "
                  "again in 2 s",
                  problem),
      shot);
}

void Stepper::on(const event::FrameCommitted& e) {
  const auto it = find_held(e.frame);
  if (it == s_.held.end()) {
    return;
  }
  shot_state(it->shot) = ShotState::committed;
  ++s_.n_committed;
  ++s_.counters.commits;
  s_.failures = 0;
  s_.held.erase(it);
  drop(e.frame);
  s_.retry_disk_ns = kNever;
  clear_reason(kDiskFull | kFolderGone);
  withdraw_doubted();
  advance(std::nullopt);
}

void Stepper::on(const event::CommitFault& e) {
  if (s_.plan == nullptr) {
    return;
  }
  ++s_.counters.commit_faults;
  if (e.code == Errc::refused || e.code == Errc::protocol) {
    abort("session: " + e.what);  // neither time nor space will fix it
    return;
  }
  s_.retry_disk_ns = t_ + kDiskRetryNs;
  const bool is_gone = e.code == Errc::device_gone;
  s_.reasons &= ~(is_gone ? kDiskFull : kFolderGone);
  add_reason(is_gone ? kFolderGone : kDiskFull, (is_gone ? "session: " : "disk: ") + e.what,
             shot_under_way());
}

void Stepper::on(const event::DiskGood&) {
  s_.retry_disk_ns = kNever;
  clear_reason(kDiskFull | kFolderGone);
}

void Stepper::on(const event::SessionFinished&) {
  if (s_.phase != Phase::finalise) {
    return;
  }
  s_.is_finished = true;
  s_.reasons = 0;
  s_.retry_disk_ns = kNever;
  stop_camera();
  enter(Phase::done, fmt::format("{} shots", s_.shots.size()));
}

}  // namespace haarlight::capture
