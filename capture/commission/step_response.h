// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <span>
#include <vector>

/// @file
/// What rows exposed while a light steps reveal about timing. Pure. Notes, sources and measured
/// errors: docs/numerics/commissioning.md.
///
/// A light is switched by a request that the host locates between its sending and its
/// acknowledgement; the middle is t_l. The LED follows after `latch`, then ramps linearly over
/// T from 0 to 100 %. A frame's timestamp ts is its first row's exposure start plus d, which
/// depends on the timestamp's meaning: 0, E, or E + t_read. A row at `row` (0 first .. 1 last)
/// starts row * skew later. With
///
///     x = (ts - t_l) + row skew + E - D,      D = d + latch
///
/// the time from the LED's first change to the end of that row's exposure, the row sees the
/// fraction
///
///     G(x) = (H(x) - H(x - E)) / E,   H(u) = 0, u^2 / 2T, u - T/2   for u < 0, < T, >= T
///
/// of a rising step, 1 - G of a falling one. A fit of all rows gives D for each exposure time,
/// skew, and both ramps.

namespace haarlight::capture {

/// One row (or thin band of rows) of one frame near one step. Times in microseconds.
struct StepSample {
  int step = 0;  ///< samples of one step share its error; the jackknife's groups
  bool rises = true;
  double after_us = 0.0;   ///< ts - t_l
  double jitter_us = 0.0;  ///< 1 sigma of t_l: (round trip) / (2 sqrt 3)
  double exposure_us = 0.0;
  double row = 0.0;     ///< 0 .. 1
  double level = 0.0;   ///< 0 = dark, 1 = lit
  double sigma = 0.01;  ///< of level
};

/// G(x) above; 0 <= G <= 1. @param ramp_us  T >= 0
[[nodiscard]] double lit_fraction(double x_us, double exposure_us, double ramp_us);

struct StepModel {
  std::vector<double> exposures_us;  ///< rising
  std::vector<double> offset_us;     ///< D of each
  double skew_us = 0.0;
  double rise_us = 0.0;
  double fall_us = 0.0;
};

struct StepFit {
  StepModel model;
  // Standard uncertainties by a delete-a-group jackknife over steps; and what the jitter of the
  // steps adds to a ramp, sqrt(T^2 + 12 jitter^2) - T, which the fit cannot separate from T.
  std::vector<double> offset_sigma_us;
  std::vector<double> offset_jackknife_us;  ///< without the jitter's part, common to all
  double skew_sigma_us = 0.0;
  double rise_sigma_us = 0.0;
  double fall_sigma_us = 0.0;
  double settle_sigma_us = 0.0;  ///< of the first offset + the slower ramp; jackknife alone
  int n_steps = 0;
  int n_partial = 0;     ///< samples that saw part of a step: the informative ones
  double scatter = 0.0;  ///< robust rms of (level - model) / sigma; 1 = as expected
};

struct StepFitOptions {
  /// D = D0 + slope E with one D0 for all exposures; nothing: D of each exposure free.
  std::optional<double> slope;
  std::optional<StepModel> start;  ///< else estimated from the samples
  /// Standard deviation of the light's own delay from step to step: it rounds the steps like a
  /// longer ramp, and enters the sigmas of ramps and offsets.
  double scatter_us = 0.0;
  /// Each step has a delay of its own, common to its rows, of standard deviation scatter_us and
  /// its jitter_us; otherwise jitter_us is noise of each sample. Exact for the skew, in which
  /// the rows of one step differ; not for ramps and offsets where a step is seen at only one
  /// point of its ramp (a global shutter): the delays then absorb what belongs to the ramp.
  bool has_own_delays = false;
};

/// Robust (Huber) Levenberg-Marquardt. Cost: O(samples) per iteration, 20 jackknife groups.
/// @return  nothing when the samples carry too little information: fewer than 4 steps partially
///          seen, or an exposure without any
[[nodiscard]] std::optional<StepFit> fit_steps(std::span<const StepSample> samples,
                                               const StepFitOptions& options = {});

/// One step's own delay relative to the model's.
struct StepDelay {
  int step = 0;
  double late_us = 0.0;
  double sigma_us = 0.0;  ///< from the samples' noise
};
/// Of every partially seen step, by least squares over its rows and frames, each sample
/// linearised at the model; only those known to 50 us. A longer ramp looks like half a delay.
[[nodiscard]] std::vector<StepDelay> step_delays(std::span<const StepSample> samples,
                                                 const StepModel& model);
/// Standard deviation of the delays themselves, with their noise removed; 0 for fewer than
/// four.
[[nodiscard]] double delay_scatter(std::span<const StepDelay> delays);

/// How long an exposure really lasts, relative to what the camera reports.
struct ExposureScale {
  double value = 1.0;
  double sigma = 0.0;  ///< by a delete-a-step jackknife
  int n_steps = 0;     ///< those partially seen
};

/// The fraction seen grows by 1 / E_true per microsecond where the whole ramp lies inside the
/// exposure: between 0.15 and 0.85 while the ramp is below 0.3 E; a longer ramp looks like a
/// longer exposure, with a different scale at every exposure. The slope over after / E, pooled
/// over rows and directions, each with its own offset: neither skew nor the timestamp's meaning
/// matters.
/// @param exposure_us  selects the samples: those with this reported exposure
/// @return  nothing for fewer than 4 such steps partially seen, or where fractions do not grow
///     with time
[[nodiscard]] std::optional<ExposureScale> exposure_scale(std::span<const StepSample> samples,
                                                          double exposure_us);

/// The straight line offset = c + slope E through the offsets of a free fit.
struct OffsetLine {
  double slope = 0.0;
  double slope_sigma = 0.0;
};
/// @pre at least two exposures
[[nodiscard]] OffsetLine offset_line(const StepFit& fit);

}  // namespace haarlight::capture
