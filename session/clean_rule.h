// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <limits>
#include <string>

#include "haarlight/core/rig/rig.h"
#include "haarlight/session/evidence.h"

/// @file
/// The clean rule: a frame belongs to a light only when it was exposed entirely while that
/// light's pattern, and nothing else, was lit. Used by the sequencer when it commits, by
/// recovery when it adopts, and by `haarlight verify`. Pure.
///
///     clean  <=>  first row's exposure start >= t_stable  and  last row's end <= next change
///     first-row start = ts                   the timestamp means start of exposure
///                     = ts - E               start of readout
///                     = ts - t_read - E      end of frame
///     last-row end    = first-row start + E + skew

namespace haarlight::session {

/// t_next_change_ns of a frame after which nothing was commanded.
inline constexpr std::int64_t kNoNextChange = std::numeric_limits<std::int64_t>::max();

/// The camera's data about one frame. Times in microseconds, the timestamp in ns
/// CLOCK_MONOTONIC.
struct ExposureTiming {
  std::int64_t timestamp_ns = 0;
  TimestampMeaning meaning = TimestampMeaning::end_frame;
  double exposure_us = 0.0;  ///< E
  double read_us = 0.0;      ///< t_read: end of the first row's exposure to the timestamped
                             ///< event
  double skew_us = 0.0;      ///< last row's exposure start minus the first row's
};

/// From the first row's exposure start to the last row's exposure end, ns.
struct ExposureWindow {
  std::int64_t start_ns = 0;
  std::int64_t end_ns = 0;
  friend bool operator==(const ExposureWindow&, const ExposureWindow&) = default;
};

/// E, t_read and skew are rounded to whole ns, then added exactly; saturates at the limits of
/// int64.
[[nodiscard]] ExposureWindow exposure_window(const ExposureTiming& timing) noexcept;

/// The distance of an exposure to the nearest light change.
struct CleanVerdict {
  bool is_clean = false;
  double margin_us =
      0.0;  ///< min(start - t_stable, next change - end); negative: by how much it fails
};

[[nodiscard]] CleanVerdict assess_clean(const ExposureWindow& window, std::int64_t t_stable_ns,
                                        std::int64_t t_next_change_ns) noexcept;

/// Camera leads: no acknowledgement exists, so each frame's light must settle inside its
/// period: E + skew + settle + guard <= period. @return the margin, us; negative: the plan does
/// not fit
[[nodiscard]] double camera_leads_margin_us(double exposure_us, double skew_us,
                                            double settle_us, double guard_us,
                                            double period_us) noexcept;

/// Validates stored evidence by itself: the tag was echoed; command, acknowledgement, read-back
/// and stable light are in order; the stored window follows from the timestamp; the window is
/// clean (or, where the camera leads, the step counter went from k to k + 1); and the driver
/// flagged nothing. Asserted evidence (an import) only needs its pixel hash.
/// @return  empty when it holds, otherwise the reason in words
[[nodiscard]] std::string find_evidence_problem(const FrameEvidence& evidence);

}  // namespace haarlight::session
