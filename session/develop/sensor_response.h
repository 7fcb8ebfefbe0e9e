// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/session/session.h"

/// @file
/// Converts a session's samples to electrons, using the noise in the rig file (measured by
/// `haarlight rig commission`, or the manufacturer's). Pure.

namespace haarlight::session {

/// Electrons of a sample: (DN - black) * electrons_per_dn_at(gain). Variance of a sample of n
/// electrons, in electrons^2: n + read^2 + rounding^2 / 12.
struct SensorResponse {
  double electrons_per_dn = 1.0;  ///< at gain_db
  double gain_db = 0.0;           ///< at which it was measured
  double read_e = 0.0;            ///< rms
  double black_dn = 0.0;
  double white_dn = 65535.0;
  /// Samples are clipped from here on (session/clip_level.h).
  double clip_dn = 65535.0;
  /// The rig file gives the noise. Otherwise samples are weighted as if there were only photon
  /// noise, and no standard error can be given.
  bool is_measured = false;

  /// Gain reduces the electrons per step.
  [[nodiscard]] double electrons_per_dn_at(double frame_gain_db) const;
  /// Variance without light, electrons^2: read noise and rounding.
  [[nodiscard]] double floor_variance(double frame_gain_db) const;
  [[nodiscard]] double range_dn() const { return white_dn - black_dn; }
};

/// The response of a session's frames.
/// @throws Error  a gain of zero, a white level at or below black, a black level above the
///                picture (every light frame's mean is below it), a noise model for samples
///                that are not linear
[[nodiscard]] SensorResponse sensor_response(const Session& session);

}  // namespace haarlight::session
