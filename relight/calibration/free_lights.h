// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "relight/calibration/near_calibration.h"

/// @file
/// Lights of which nobody knows where they are, nor their axes for certain: a dome, lamps on
/// stands, a flash in the hand. calibrate_free_lights() takes axes as given; here they follow
/// from where the lights are found, but for what their aim is off. Notes and measured errors:
/// docs/numerics/near-light.md.

namespace haarlight {

/// Which way the lights shine.
enum class Aim {
  centre,      ///< at the middle of the target, as in a dome
  down,        ///< at right angles to the target, as in a flat panel
  everywhere,  ///< alike in all directions: mu = 0
};

struct FreeLightOptions {
  Aim aim = Aim::centre;
  /// How far a light's axis is off its aim, standard deviation in each of two directions.
  double aim_sigma_deg = 3.0;
  double led_mm = 0.0;  ///< side of the lights' emitters, taken as squares across their axes
  CalibrationOptions lights;
};

/// calibrate_free_lights() from paper_start(), axes following the places; how far each is off
/// its aim is an unknown with a prior, and so in every sigma: an axis and a shift to the side
/// change a picture alike to first order. @throws Error  as calibrate_free_lights()
[[nodiscard]] LightCalibration find_free_lights(const TargetSamples& samples,
                                                const FreeLightOptions& options = {});

/// What the pictures do not tell, as one standard deviation of it moves the lights: added to
/// every sigma of place and power. @param moved  the same fit with that deviation
void add_deviation(LightCalibration& found, const LightCalibration& moved);

}  // namespace haarlight
