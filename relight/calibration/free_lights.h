// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <span>
#include <string_view>

#include "haarlight/core/enum_words.h"
#include "relight/calibration/near_calibration.h"

/// @file
/// Lights of unknown position and uncertain axis: a dome, lamps on stands, a hand-held flash.
/// calibrate_free_lights() takes axes as given; here they follow from the positions found, up
/// to an aiming error. Notes and measured errors: docs/numerics/near-light.md.

namespace haarlight::relight {

/// Which way the lights shine.
enum class Aim {
  centre,      ///< at the middle of the target, as in a dome
  down,        ///< perpendicular to the target, as in a flat panel
  everywhere,  ///< isotropic: mu = 0
};
inline constexpr auto kAimWords =
    std::to_array<std::string_view>({"centre", "down", "everywhere"});
constexpr std::span<const std::string_view> words_of(Aim) { return kAimWords; }

struct FreeLightOptions {
  Aim aim = Aim::centre;
  /// Aiming error of a light's axis, standard deviation in each of two directions.
  double aim_sigma_deg = 3.0;
  double led_mm = 0.0;  ///< side of the emitters, squares perpendicular to their axes
  CalibrationOptions lights;
};

/// calibrate_free_lights() from paper_start(), axes following the positions; each light's
/// aiming error is an unknown with a prior, and so in every sigma: tilting the axis and
/// shifting the light sideways change a picture alike to first order. @throws Error  as
/// calibrate_free_lights()
[[nodiscard]] LightCalibration find_free_lights(const TargetSamples& samples,
                                                const FreeLightOptions& options = {});

/// A parameter the pictures do not determine: the effect of one standard deviation of it, added
/// to every sigma of position and power. @param moved  the same fit with that deviation
void add_deviation(LightCalibration& found, const LightCalibration& moved);

}  // namespace haarlight::relight
