// SPDX-License-Identifier: Apache-2.0
#include "capture/commission/timestamp_meaning.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr double kSureOfSlope = 5.0;  // sigmas
constexpr double kSlopeTol = 0.1;     // a timestamp in the middle of an exposure would give 0.5
constexpr double kOnFrame = 0.05;     // of a period: the exposure is fixed at the frame's start
constexpr double kSkewTol = 0.95;     // of the skew: a frame cannot arrive before its last row

/// The distance to the nearest whole number.
double off_whole(double x) { return std::abs(x - std::round(x)); }

}  // namespace

double ControlPhase::sigma_us() const { return (high_us - low_us) / std::sqrt(12.0); }

std::optional<ControlPhase> control_phase(std::span<const ControlTrial> trials,
                                          double period_us, double tolerance_us) {
  HAARLIGHT_EXPECTS(period_us > 0.0, "a frame period");
  if (trials.empty()) {
    return std::nullopt;
  }
  ControlPhase phase{-std::numeric_limits<double>::infinity(),
                     std::numeric_limits<double>::infinity(), static_cast<int>(trials.size())};
  for (const ControlTrial& t : trials) {
    phase.high_us = std::min(phase.high_us, t.reference_us - t.before_us);
    phase.low_us = std::max(phase.low_us, t.reference_us - t.after_us - period_us);
  }
  if (phase.low_us > phase.high_us + tolerance_us) {
    return std::nullopt;
  }
  if (phase.low_us > phase.high_us) {
    std::swap(phase.low_us, phase.high_us);  // by less than the tolerance: timestamp jitter
  }
  return phase;
}

bool is_slope_sure(double slope_sigma) { return kSureOfSlope * slope_sigma < 0.5; }

std::optional<TimestampVerdict> classify_timestamp(const TimestampEvidence& e) {
  const double tol = std::max(kSlopeTol, kSureOfSlope * e.slope_sigma);
  const bool follows = std::abs(e.slope - 1.0) <= tol;
  if ((!follows && std::abs(e.slope) > tol) || !is_slope_sure(e.slope_sigma)) {
    return std::nullopt;
  }
  TimestampVerdict v;
  const std::string slope =
      fmt::format("offset over exposure {:.3f} +- {:.3f}", e.slope, e.slope_sigma);
  if (!follows) {
    v.meaning = TimestampMeaning::start_exposure;
    v.evidence = slope;
  } else {
    // From the timestamp to the host: all of the readout, or only what comes after it.
    const bool too_soon = e.arrival_us < kSkewTol * e.skew_us;
    const bool too_late = e.offset_us < kSkewTol * e.skew_us;
    const bool is_end = too_soon || (!too_late && e.arrival_us < e.offset_us);
    v.meaning = is_end ? TimestampMeaning::end_frame : TimestampMeaning::start_readout;
    v.evidence = fmt::format(
        "{}; frames come {:.2f} ms after their timestamp at the soonest, the "
        "light {:.2f} ms before it",
        slope, e.arrival_us / 1e3, e.offset_us / 1e3);
  }
  double read = 0.0;
  double read_sigma = 0.0;
  if (e.control) {
    const double frames = e.control->value_us() / e.period_us;
    const bool on_frame = off_whole(frames) < kOnFrame;
    double delay = std::round(frames);
    if (v.meaning == TimestampMeaning::end_frame) {
      delay = std::floor(frames + 1e-3);
      read = e.control->value_us() - delay * e.period_us;
      read_sigma = e.control->sigma_us();
      // The light's delay cannot be negative: then the exposure is not fixed at the frame's
      // start.
      v.is_divided = delay >= 0.0 && read <= e.offset_us + 3.0 * e.offset_sigma_us;
    } else if (!on_frame) {
      delay = std::ceil(frames);
      v.evidence += fmt::format(
          "; a new exposure takes hold {:.2f} frames after the start of "
          "an exposure",
          frames - std::floor(frames));
    }
    v.exposure_delay_frames =
        Measured{std::max(0.0, delay), e.control->sigma_us() / e.period_us, e.control->n};
  } else {
    v.is_divided = v.meaning != TimestampMeaning::end_frame;
    v.evidence += "; new exposures take hold at no fixed moment";
  }
  if (v.meaning == TimestampMeaning::end_frame) {
    double latch = std::max(0.0, e.offset_us - read);
    double latch_sigma = std::hypot(e.offset_sigma_us, read_sigma);
    if (!v.is_divided) {
      latch = std::clamp(e.written_latch_us, 0.0, e.offset_us);
      read = e.offset_us - latch;
      read_sigma = latch_sigma = std::max(latch, read) / std::sqrt(3.0);
      v.evidence += "; only the sum of latch and read_us is measured, the rig file divides it";
    }
    const int n = e.control ? e.control->n : 0;
    v.latch_us = {latch, latch_sigma, n};
    v.read_us = Measured{read, std::max(read_sigma, 0.0), n};
  } else {
    v.latch_us = {std::max(0.0, e.offset_us), e.offset_sigma_us, 0};
  }
  const double from_end = v.meaning == TimestampMeaning::start_exposure ? -e.exposure_us
                          : v.meaning == TimestampMeaning::end_frame    ? read
                                                                        : 0.0;
  v.ready_us = {e.arrival_us + from_end - std::max(0.0, e.skew_us),
                std::hypot(e.arrival_sigma_us, read_sigma), 1};
  return v;
}

}  // namespace haarlight::capture
