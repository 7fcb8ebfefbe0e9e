// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <span>
#include <string>

#include "core/rig/measured_rig.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// What a camera's timestamp means, and how the measured offset divides into the light's delay
/// and the camera's readout. Pure. Notes: docs/numerics/commissioning.md.
///
/// The offset D = d + latch of step_response.h depends on the exposure E with a slope:
///
///     start of exposure   d = 0            slope 0      D0 = latch
///     start of readout    d = E            slope 1      D0 = latch
///     end of frame        d = E + t_read   slope 1      D0 = latch + t_read
///
/// The last two are distinguished by a frame's shortest time from its timestamp to the host: it
/// contains the readout when the timestamp is at its start. Light alone gives only the sum
/// latch + t_read, which is all that the rule for clean frames needs (session/clean_rule.h);
/// the two parts come from the moment at which a newly set exposure takes effect.

namespace haarlight::capture {

/// One change of exposure: set between `before` and `after`, first seen in a frame whose
/// timestamp less slope * E is `reference`. Microseconds of one clock.
struct ControlTrial {
  double before_us = 0.0;
  double after_us = 0.0;
  double reference_us = 0.0;
};

/// reference - (moment of setting) lies in (phase, phase + period]; so each trial narrows
/// phase from both sides.
struct ControlPhase {
  double low_us = 0.0;
  double high_us = 0.0;
  int n = 0;
  [[nodiscard]] double value_us() const { return 0.5 * (low_us + high_us); }
  /// Standard uncertainty of a uniform distribution between the two ends.
  [[nodiscard]] double sigma_us() const;
};

/// @return  nothing when the trials contradict each other by more than `tolerance_us`: the
///          camera does not latch its exposure at a fixed moment of the frame
[[nodiscard]] std::optional<ControlPhase> control_phase(std::span<const ControlTrial> trials,
                                                        double period_us, double tolerance_us);

struct TimestampEvidence {
  double slope = 0.0;
  double slope_sigma = 0.0;
  double offset_us = 0.0;  ///< D0: the offset less (rounded slope) * E
  double offset_sigma_us = 0.0;
  double skew_us = 0.0;
  double exposure_us = 0.0;  ///< of the arrivals
  double arrival_us = 0.0;   ///< shortest time from a timestamp to the host
  double arrival_sigma_us = 0.0;
  double period_us = 0.0;
  std::optional<ControlPhase> control;
  double written_latch_us = 0.0;  ///< from the rig file: the last resort for the division
};

struct TimestampVerdict {
  TimestampMeaning meaning = TimestampMeaning::end_frame;
  Measured latch_us;
  std::optional<Measured> read_us;  ///< for the end of a frame
  Measured ready_us;                ///< end of the last row's exposure to the host
  std::optional<Measured> exposure_delay_frames;
  bool is_divided = true;  ///< false: only latch + read is measured, divided by the rig file
  std::string evidence;    ///< in words
};

/// Whether a slope of this uncertainty can be told from 0, 1/2 and 1.
[[nodiscard]] bool is_slope_sure(double slope_sigma);

/// @return  nothing when the slope is neither 0 nor 1 within 5 sigma and 0.1
[[nodiscard]] std::optional<TimestampVerdict> classify_timestamp(
    const TimestampEvidence& evidence);

}  // namespace haarlight::capture
