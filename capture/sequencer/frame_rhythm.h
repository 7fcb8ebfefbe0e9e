// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "capture/plan/timing.h"

/// @file
/// Whether a frame's timestamp fits its camera's own period. A timestamp that is late but still
/// before its frame's arrival moves the exposure computed from it into the time of a light that
/// it did not see. A free-running camera reveals it: its frames are one period apart, and the
/// host knows how many there were between two. Pure apart from its own state; not for triggered
/// frames, which have no period. It uses timestamps and not pixels, so the sequencer lets it
/// learn in the dark, before the first light.
///
/// From the last 32 frames (sequence x, timestamp y, one exposure; true and false timestamps
/// alike):
///
///     P = median of (y_j - y_i) / (x_j - x_i)      a = median of (y_i - P x_i)
///     sigma = 1.4826 median |y_i - P x_i - a|      off = y - (a + P x)   of the next frame
///     on the rhythm  <=>  |off| <= tolerance = max(80 us, 4.5 sigma sqrt(1 + v))
///     v = variance of a + P x / sigma^2
///
/// Medians hold until 29 % of the timestamps are false (the slope's breakdown point). A true
/// timestamp with normal jitter is suspected in 7 of 10^6 cases, with uniform jitter never. The
/// guard covers what the tolerance lets through: guard_ns is 1.25 times the tolerance.

namespace haarlight::capture {

class FrameRhythm {
 public:
  enum class Position {
    learning,  ///< too few frames so far: nothing is known
    on,
    off,
  };
  struct Verdict {
    Position position = Position::learning;
    std::int64_t off_ns = 0;      ///< timestamp less the predicted one
    std::int64_t guard_ns = 0;    ///< largest timestamp error of a frame on the rhythm
    bool is_learnt_anew = false;  ///< too many off in a row: old rhythm discarded
  };

  /// Frames until a stream's rhythm is known, and until it is known again where a new exposure
  /// shifted the timestamps. An exposure never changes their period; where it does not shift
  /// the timestamps either, one frame is enough.
  static constexpr std::size_t kFirst = kFramesToLearn;
  static constexpr std::size_t kAgain = 3;

  /// The stream's next frame, with a sequence above all earlier ones.
  [[nodiscard]] Verdict classify(std::uint64_t sequence, std::int64_t timestamp_ns,
                                 double exposure_us);
  /// The stream's numbering restarts; the period is kept.
  void restart() { n_ = 0; }
  /// Whether the next frame can be classified as on or off; after a change of exposure the one
  /// after it.
  [[nodiscard]] bool is_known() const { return n_ >= (period_ns_ > 0.0 ? kAgain : kFirst); }

  [[nodiscard]] double period_ns() const { return period_ns_; }
  [[nodiscard]] double sigma_ns() const { return sigma_ns_; }

 private:
  struct Timestamp {
    std::uint64_t sequence = 0;
    std::int64_t timestamp_ns = 0;
  };
  static constexpr std::size_t kKept = 32;
  static constexpr int kOffToForget = 6;  ///< in a row; at 5 % false ones: once in 6e7 frames

  void keep(Timestamp timestamp);
  /// Fits period, phase and scatter to the window.
  void fit();

  std::array<Timestamp, kKept> timestamps_{};  ///< oldest first
  std::size_t n_ = 0;
  double period_ns_ = 0.0;        ///< 0: unknown
  double period_sigma_ns_ = 0.0;  ///< standard error of the period
  double phase_ns_ = 0.0;         ///< relative to the newest timestamp: a - y
  double sigma_ns_ = 0.0;         ///< of one timestamp
  double exposure_us_ = 0.0;
  std::uint64_t slip_ = 0;        ///< periods lost by the driver without being counted
  int n_off_ = 0;                 ///< in a row
  bool is_exposure_new_ = false;  ///< no frame arrived since it changed
  unsigned n_since_period_ = 0;
};

}  // namespace haarlight::capture
