// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "capture/sequencer/sequencer.h"
#include "haarlight/session/session.h"

/// @file
/// What the operator wants to know of a run besides its state: why a shot was retaken, which
/// frames look doubtful, and how long things took. Sees every event and action of the sequencer
/// and changes none.

namespace haarlight::capture {

/// Counts of a quantity in fixed bins, in Prometheus form. Not thread-safe.
class Histogram {
 public:
  /// @param bounds  upper bounds of the bins, ascending; one more bin takes the rest
  explicit Histogram(std::vector<double> bounds);
  void add(double value);
  /// The lines of one metric in the text format, including HELP and TYPE.
  [[nodiscard]] std::string text(std::string_view name, std::string_view help) const;
  [[nodiscard]] std::uint64_t count() const noexcept { return count_; }

 private:
  std::vector<double> bounds_;
  std::vector<std::uint64_t> classes_;  ///< one more than bounds
  std::uint64_t count_ = 0;
  double sum_ = 0.0;
};

/// The symbol of a shot in the map.
enum class ShotMark : char {
  pending = '.',
  lit = '*',       ///< its light is on now
  checking = '~',  ///< the frame has arrived but is not yet safe on disk
  committed = 'o',
  suspect = '?',  ///< committed, but worth an operator's look: ShotNote::doubt says why
  failed = 'x',   ///< the last attempt gave no frame; it will be retried
  waiting = 'w',  ///< to be retaken on request
  reshot = 'r',   ///< committed, but not with its first frame
};

/// @param attempt  of the committed frame, from 0
[[nodiscard]] ShotMark mark_of_committed(int attempt, const std::string& doubt) noexcept;

/// What is known of a shot since the start of this run.
struct ShotNote {
  int attempt = 0;             ///< newest one with a frame
  bool was_requested = false;  ///< retaken at the operator's request
  std::string problem;         ///< why the last attempt gave no frame; empty after a good one
  std::string doubt;           ///< of the committed frame, see doubt_of
};

/// Thread-safe: written by the control thread, read by HTTP.
class RunObserver {
 public:
  RunObserver();

  /// A session was opened. @param kinds  of its shots; @param next_attempt  of each
  void begin(std::vector<session::ShotKind> kinds, session::FrameForm form,
             const std::vector<int>& next_attempt);
  void see(std::int64_t now_ns, const EventBody& event);
  void see(std::int64_t now_ns, const Action& action);

  /// One ShotMark per shot. @param states  of DaemonState
  [[nodiscard]] std::string marks(const std::vector<ShotState>& states) const;
  [[nodiscard]] ShotNote note(int shot) const;
  /// Histograms as Prometheus text.
  [[nodiscard]] std::string metrics() const;

 private:
  [[nodiscard]] ShotNote* note_of(int shot);

  mutable std::mutex mutex_;
  std::vector<ShotNote> notes_;
  std::vector<session::ShotKind> kinds_;
  session::FrameForm form_;
  std::map<std::uint64_t, std::int64_t> commit_begun_ns_;  ///< by frame
  std::int64_t shown_ns_ = 0;
  Histogram margins_;
  Histogram latches_;
  Histogram arrivals_;
  Histogram waits_;
  Histogram commits_;
};

}  // namespace haarlight::capture
