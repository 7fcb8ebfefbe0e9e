// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "capture/commission/commission_bench.h"
#include "capture/commission/light_survey.h"
#include "capture/commission/photon_transfer.h"
#include "capture/commission/step_response.h"
#include "capture/commission/timestamp_meaning.h"
#include "core/rig/measured_rig.h"

/// @file
/// Commissioning: measures a rig's delays, its camera's timestamps and noise, and its LEDs, by
/// stepped light. docs/reference/commissioning.md is for the operator,
/// docs/numerics/commissioning.md for the estimators and their measured errors.
///
///     timing   the light is switched at chosen moments of the exposure; step_response.h
///     control  the exposure is switched under steady light; timestamp_meaning.h
///     noise    pairs of pictures from dark to beyond saturation; photon_transfer.h
///     lights   each LED alone; light_survey.h

namespace haarlight::capture {

struct CommissionOptions {
  int camera = 0;
  int fine_steps = 80;      ///< switches of the light at each of two exposures
  int control_trials = 40;  ///< switches of the exposure; up to four times that on a busy host
  bool measures_noise = true;
  bool measures_lights = true;
  std::string date;                   ///< ISO 8601, into the measured file
  std::string written_hash;           ///< of the rig file's own text
  std::function<bool()> should_stop;  ///< polled between frames
  std::function<void(std::string_view stage, double fraction)> progress;
};

struct TimingResult {
  std::vector<StepSample> samples;
  StepFit fit;  ///< D constrained to the fitted slope
  OffsetLine line;
  TimestampEvidence evidence;
  TimestampVerdict verdict;
  Measured ack_us;
  double long_us = 0.0;  ///< the exposures used
  double short_us = 0.0;
  int n_lights = 0;  ///< lit together at the longer exposure
  /// The latest the light began to change after the instant from which captures count settling,
  /// over all steps, plus 2.33 standard errors of the ramp's end.
  Measured latch_most_us;
  double linear_dn = 0.0;     ///< signal up to which the sensor response was seen to be linear
  double count_per_us = 0.0;  ///< bright pixels' signal per light and microsecond of exposure
};

struct NoiseResult {
  std::vector<TransferBin> bins;
  std::vector<ExposureLevel> levels;
  SensorMeasurement sensor;
};

struct CommissionResult {
  MeasuredRig measured;
  TimingResult timing;
  std::optional<NoiseResult> noise;
  std::optional<LightSurvey> survey;
  /// The rig file contradicts the measurement here; the measured file must not be used before
  /// it is corrected.
  std::vector<std::string> contradictions;
  /// Lights that need repair: dead, dim or wired to another's position. What was measured
  /// holds.
  std::vector<std::string> faults;
  std::vector<std::string> notes;
};

/// @param rig  as written, without an older measured file
/// @throws Error(unavailable)  a device failed or is in use; (interrupted) stopped; (bad_input)
///         the picture shows too little: no light in view, no step seen, a timestamp that fits
///         none of the three meanings. The lights are off in every case.
[[nodiscard]] CommissionResult commission(const Rig& rig, Camera& camera,
                                          firmware_iface::LightArray& lights,
                                          const CommissionOptions& options,
                                          CommissionClock clock = monotonic_clock());

// The stages, each on an open bench. Errors as above.
[[nodiscard]] TimingResult measure_timing(CommissionBench& bench,
                                          const CommissionOptions& options);
[[nodiscard]] NoiseResult measure_noise(CommissionBench& bench, const TimingResult& timing,
                                        const CommissionOptions& options);
[[nodiscard]] LightSurvey measure_lights(CommissionBench& bench, const TimingResult& timing,
                                         double gain_e_per_dn,
                                         const CommissionOptions& options);

}  // namespace haarlight::capture
