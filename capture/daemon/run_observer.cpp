// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/run_observer.h"

#include <algorithm>
#include <utility>
#include <variant>

#include <fmt/format.h>

#include "capture/daemon/frame_words.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr std::size_t kMarksAtOnce = 4096;
constexpr std::size_t kMaxCommitsKnown = 4096;  // leftovers of an aborted run

double seconds_between(std::int64_t from_ns, std::int64_t to_ns) {
  return static_cast<double>(to_ns - from_ns) / 1e9;
}

std::vector<double> classes_from_100us() {
  return {1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2, 0.5, 1.0};
}

}  // namespace

Histogram::Histogram(std::vector<double> bounds)
    : bounds_(std::move(bounds)), classes_(bounds_.size() + 1, 0) {
  HAARLIGHT_EXPECTS(std::is_sorted(bounds_.begin(), bounds_.end()), "ascending bounds");
}

void Histogram::add(double value) {
  const auto position = std::lower_bound(bounds_.begin(), bounds_.end(), value);
  ++classes_[static_cast<std::size_t>(position - bounds_.begin())];
  ++count_;
  sum_ += value;
}

std::string Histogram::text(std::string_view name, std::string_view help) const {
  std::string out =
      fmt::format("# HELP haarlight_{0} {1}\n# TYPE haarlight_{0} histogram\n", name, help);
  std::uint64_t n = 0;
  for (std::size_t i = 0; i < bounds_.size(); ++i) {
    n += classes_[i];
    out += fmt::format("haarlight_{}_bucket{{le=\"{:g}\"}} {}\n", name, bounds_[i], n);
  }
  out += fmt::format("haarlight_{0}_bucket{{le=\"+Inf\"}} {1}\n", name, count_);
  return out +
         fmt::format("haarlight_{0}_sum {1}\nhaarlight_{0}_count {2}\n", name, sum_, count_);
}

ShotMark mark_of_committed(int attempt, const std::string& doubt) noexcept {
  if (!doubt.empty()) {
    return ShotMark::suspect;
  }
  return attempt > 0 ? ShotMark::reshot : ShotMark::committed;
}

RunObserver::RunObserver()
    : margins_(classes_from_100us()),
      latches_(classes_from_100us()),
      arrivals_(classes_from_100us()),
      waits_({0.005, 0.01, 0.02, 0.03, 0.05, 0.075, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0}),
      commits_({0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0}) {}

void RunObserver::begin(std::vector<session::ShotKind> kinds, session::FrameForm form,
                        const std::vector<int>& next_attempt) {
  std::vector<ShotNote> notes(kinds.size());
  for (std::size_t i = 0; i < notes.size() && i < next_attempt.size(); ++i) {
    notes[i].attempt = std::max(0, next_attempt[i] - 1);
  }
  const std::lock_guard lock(mutex_);
  notes_.swap(notes);  // the old notes are freed outside the lock
  kinds_.swap(kinds);
  form_ = std::move(form);
  commit_begun_ns_.clear();
  shown_ns_ = 0;
}

ShotNote* RunObserver::note_of(int shot) {
  const auto i = static_cast<std::size_t>(shot);
  return shot >= 0 && i < notes_.size() ? &notes_[i] : nullptr;
}

void RunObserver::see(std::int64_t now_ns, const EventBody& event) {
  const std::lock_guard lock(mutex_);
  if (const auto* shown = std::get_if<event::LightShown>(&event)) {
    latches_.add(seconds_between(shown->receipt.t_command_ns, shown->receipt.t_ack_ns));
  } else if (const auto* frame = std::get_if<event::FrameArrived>(&event)) {
    arrivals_.add(seconds_between(frame->info.timestamp_ns, now_ns));
  } else if (const auto* done = std::get_if<event::FrameCommitted>(&event)) {
    const auto begun = commit_begun_ns_.find(done->frame);
    if (begun != commit_begun_ns_.end()) {
      commits_.add(seconds_between(begun->second, now_ns));
      commit_begun_ns_.erase(begun);
    }
  }
}

void RunObserver::see(std::int64_t now_ns, const Action& action) {
  const std::lock_guard lock(mutex_);
  if (const auto* check = std::get_if<action::CheckFrame>(&action)) {
    waits_.add(seconds_between(check->evidence.t_command_ns, now_ns));
  } else if (const auto* commit = std::get_if<action::CommitFrame>(&action)) {
    margins_.add(commit->evidence.margin_us * 1e-6);
    if (commit_begun_ns_.size() < kMaxCommitsKnown) {
      commit_begun_ns_[commit->frame] = now_ns;
    }
    if (ShotNote* note = note_of(commit->shot)) {
      note->attempt = commit->attempt;
      note->problem.clear();
      note->doubt =
          doubt_of(commit->evidence, form_, kinds_[static_cast<std::size_t>(commit->shot)]);
    }
  } else if (const auto* line = std::get_if<action::LogEvent>(&action)) {
    if (ShotNote* note =
            line->kind == session::EventKind::retry ? note_of(line->shot) : nullptr) {
      note->problem = line->text;
    }
  } else if (const auto* withdraw = std::get_if<action::WithdrawShots>(&action)) {
    for (const int shot : withdraw->shots) {
      if (ShotNote* note = note_of(shot)) {
        note->was_requested = true;
        note->doubt.clear();
        note->problem.clear();
      }
    }
  } else if (std::holds_alternative<action::ForgetCommits>(action)) {
    commit_begun_ns_.clear();
  }
}

std::string RunObserver::marks(const std::vector<ShotState>& states) const {
  // In pieces: the control thread never waits for a whole map.
  std::string text(states.size(), static_cast<char>(ShotMark::pending));
  const ShotNote none;
  std::unique_lock lock(mutex_);
  for (std::size_t i = 0; i < states.size(); ++i) {
    if (i > 0 && i % kMarksAtOnce == 0) {
      lock.unlock();
      lock.lock();
    }
    const ShotNote& note = i < notes_.size() ? notes_[i] : none;
    ShotMark mark = ShotMark::pending;
    switch (states[i]) {
      case ShotState::pending:
        mark = !note.problem.empty() ? ShotMark::failed
               : note.was_requested  ? ShotMark::waiting
                                     : ShotMark::pending;
        break;
      case ShotState::exposing:
        mark = ShotMark::lit;
        break;
      case ShotState::checking:
      case ShotState::committing:
        mark = ShotMark::checking;
        break;
      case ShotState::committed:
        mark = mark_of_committed(note.attempt, note.doubt);
        break;
    }
    text[i] = static_cast<char>(mark);
  }
  return text;
}

ShotNote RunObserver::note(int shot) const {
  const std::lock_guard lock(mutex_);
  const auto i = static_cast<std::size_t>(shot);
  return shot >= 0 && i < notes_.size() ? notes_[i] : ShotNote{};
}

std::string RunObserver::metrics() const {
  const std::lock_guard lock(mutex_);
  return margins_.text("margin_seconds",
                       "Smallest distance of a kept exposure to a change of light") +
         latches_.text("latch_seconds",
                       "From the command to the lights to its acknowledgement") +
         arrivals_.text("frame_arrival_seconds",
                        "From a frame's timestamp until the control thread has it") +
         waits_.text("shot_seconds", "From the command to the lights to an accepted frame") +
         commits_.text("commit_seconds", "From the order to store a frame until it is durable");
}

}  // namespace haarlight::capture
