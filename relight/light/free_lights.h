#pragma once

#include "relight/light/near_calibration.h"

/// @file
/// Lights of which nobody knows where they are, nor their axes for certain: a dome, lamps on
/// stands, a flash in the hand. calibrate_free_lights() takes axes as given; here they follow
/// from where the lights are found, and what their aim is not known to goes into the
/// uncertainties. Notes and measured errors: docs/numerics/near-light.md.

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
  int max_rounds = 12;
  double settled_deg = 0.01;  ///< no axis turns by more from one round to the next
};

struct FreeLights {
  LightCalibration lights;  ///< sigmas with the aim's share
  int n_rounds = 0;
  double last_turn_deg = 0.0;
  bool is_settled = true;
};

/// Rounds of calibrate_free_lights(), axes aimed anew after each; the first takes the lights as
/// isotropic. @throws Error  as calibrate_free_lights()
[[nodiscard]] FreeLights find_free_lights(const TargetSamples& samples,
                                          const FreeLightOptions& options = {});

/// Adds to every light's sigma what an axis off by `aim_sigma_deg` moves it: of the light
/// alone, by least squares over its samples, the albedo held. An axis and a shift to the side
/// change a picture alike to first order: 3 degrees at 500 mm are some 9 mm.
void add_aim_uncertainty(LightCalibration& lights, const TargetSamples& samples,
                         double aim_sigma_deg);

}  // namespace haarlight
