// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "capture/sequencer/sequencer.h"
#include "session/session.h"

/// @file
/// What people want to know of a run beside its state: why a shot was taken again, which frames
/// look doubtful, and how long things took. Sees every event and action of the sequencer and
/// changes none.

namespace haarlight {

/// Counts of a quantity in fixed classes, as Prometheus wants them. Not thread-safe.
class Histogram {
 public:
  /// @param bounds  upper bounds of the classes, ascending; one more class takes the rest
  explicit Histogram(std::vector<double> bounds);
  void add(double value);
  /// The lines of one metric in the text format, HELP and TYPE included.
  [[nodiscard]] std::string text(std::string_view name, std::string_view help) const;
  [[nodiscard]] std::uint64_t count() const noexcept { return count_; }

 private:
  std::vector<double> bounds_;
  std::vector<std::uint64_t> classes_;  ///< one more than bounds
  std::uint64_t count_ = 0;
  double sum_ = 0.0;
};

/// How the map shows a shot: one letter each.
enum class ShotMark : char {
  pending = '.',
  lit = '*',       ///< its light burns now
  checking = '~',  ///< the frame is there, not yet safe on the disk
  committed = 'o',
  suspect = '?',  ///< committed, but a person should look: ShotNote::doubt says why
  failed = 'x',   ///< the last try gave no frame; it is tried again
  waiting = 'w',  ///< to be taken again by request
  reshot = 'r',   ///< committed, and not with its first frame
};

/// @param attempt  of the committed frame, from 0
[[nodiscard]] ShotMark mark_of_committed(int attempt, const std::string& doubt) noexcept;

/// What is known of a shot since this run began.
struct ShotNote {
  int attempt = 0;         ///< newest one with a frame
  bool was_asked = false;  ///< a person wanted it again
  std::string problem;     ///< why the last try gave no frame; empty after a good one
  std::string doubt;       ///< of the committed frame, see doubt_of
};

/// Thread-safe: the control thread tells, HTTP asks.
class RunObserver {
 public:
  RunObserver();

  /// A session was opened. @param kinds  of its shots; @param next_attempt  of each
  void begin(std::vector<ShotKind> kinds, FrameForm form, const std::vector<int>& next_attempt);
  void see(std::int64_t now_ns, const EventBody& event);
  void see(std::int64_t now_ns, const Action& action);

  /// One ShotMark a shot. @param states  of DaemonState
  [[nodiscard]] std::string marks(const std::vector<ShotState>& states) const;
  [[nodiscard]] ShotNote note(int shot) const;
  /// Histograms as Prometheus text.
  [[nodiscard]] std::string metrics() const;

 private:
  [[nodiscard]] ShotNote* note_of(int shot);

  mutable std::mutex mutex_;
  std::vector<ShotNote> notes_;
  std::vector<ShotKind> kinds_;
  FrameForm form_;
  std::map<std::uint64_t, std::int64_t> commit_begun_ns_;  ///< by frame
  std::int64_t shown_ns_ = 0;
  Histogram margins_;
  Histogram latches_;
  Histogram arrivals_;
  Histogram waits_;
  Histogram commits_;
};

}  // namespace haarlight
