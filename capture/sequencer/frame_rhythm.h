// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "capture/plan/timing.h"

/// @file
/// Whether a frame's stamp lies on its camera's own period. A stamp that is late but still
/// before its frame's arrival moves the exposure that is reckoned from it into the time of a
/// light that it did not see. A camera that runs freely betrays it: its frames follow each
/// other by one period, and the host knows how many there were between two. Pure but for its
/// own memory; not for triggered frames, which have no period. It looks at stamps and not at
/// pixels, so the sequencer lets it learn before the first light, in the dark.
///
/// Of the last 32 frames (sequence x, stamp y, one exposure; true stamps and false ones alike):
///
///     P = median of (y_j - y_i) / (x_j - x_i)      a = median of (y_i - P x_i)
///     sigma = 1.4826 median |y_i - P x_i - a|      off = y - (a + P x)   of the next frame
///     on the rhythm  <=>  |off| <= tolerance = max(80 us, 4.5 sigma sqrt(1 + what a and P
///     lack))
///
/// Medians stand until 29 % of the stamps are false (the slope's limit). A true stamp of normal
/// jitter is suspected in 7 of 10^6 cases, of even jitter never. What the tolerance lets
/// through, the guard covers: guard_ns is 1.25 times the tolerance.

namespace haarlight {

class FrameRhythm {
 public:
  enum class Place {
    learning,  ///< too few frames so far: nothing is known
    on,
    off,
  };
  struct Verdict {
    Place place = Place::learning;
    std::int64_t off_ns = 0;    ///< stamp less the rhythm's
    std::int64_t guard_ns = 0;  ///< a frame on the rhythm was stamped this close to its moment
    bool is_learnt_anew =
        false;  ///< so many were off in a row that the old rhythm is forgotten
  };

  /// Frames until a stream's rhythm is known, and until it is known again where another
  /// exposure has moved the stamps. It never moves their period; where it does not move the
  /// stamps either, one frame is enough.
  static constexpr std::size_t kFirst = kFramesToLearn;
  static constexpr std::size_t kAgain = 3;

  /// The stream's next frame, whose sequence is above that of every one before.
  [[nodiscard]] Verdict judge(std::uint64_t sequence, std::int64_t stamp_ns,
                              double exposure_us);
  /// The stream's numbers begin anew; the period is kept.
  void restart() { n_ = 0; }
  /// Whether the next frame can be told on or off; after a change of exposure the one after it.
  [[nodiscard]] bool is_known() const { return n_ >= (period_ns_ > 0.0 ? kAgain : kFirst); }

  [[nodiscard]] double period_ns() const { return period_ns_; }
  [[nodiscard]] double sigma_ns() const { return sigma_ns_; }

 private:
  struct Stamp {
    std::uint64_t sequence = 0;
    std::int64_t stamp_ns = 0;
  };
  static constexpr std::size_t kKept = 32;
  static constexpr int kOffToForget = 6;  ///< in a row; 5 % of false stamps: once in 6e7 frames

  void keep(Stamp stamp);
  /// Period, phase and scatter of what is kept.
  void fit();

  std::array<Stamp, kKept> stamps_{};  ///< the oldest first
  std::size_t n_ = 0;
  double period_ns_ = 0.0;        ///< 0: not known
  double period_sigma_ns_ = 0.0;  ///< standard error of the period
  double phase_ns_ = 0.0;         ///< of the newest stamp's place: a - y
  double sigma_ns_ = 0.0;         ///< of one stamp
  double exposure_us_ = 0.0;
  std::uint64_t slip_ = 0;        ///< periods that the driver lost without counting them
  int n_off_ = 0;                 ///< in a row
  bool is_exposure_new_ = false;  ///< no frame came since it changed
  unsigned n_since_period_ = 0;
};

}  // namespace haarlight
