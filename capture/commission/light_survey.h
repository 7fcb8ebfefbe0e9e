// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <span>
#include <vector>

#include "core/rig/measured_rig.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// Which LEDs are dead, dim or wired to another's position, from one picture under each light
/// alone. Pure. Notes and measured errors: docs/numerics/commissioning.md.
///
/// A light's expected signal is the Lambertian point source's irradiance of the shadow plane as
/// the camera sees it, times a quadratic surface over (row, column) of its face fitted to the
/// good lights: so a floor that is not matt, or a light box near one wall, is not mistaken for
/// dim LEDs. A power that varies smoothly over the face is therefore attributed to optics.
///
/// A light's position shows in how its light spreads over the picture: 8 x 8 blocks, each
/// against what geometry and the face's other lights predict for it (a quadratic surface per
/// block over the logarithms: the scene in view cancels), up to the light's power. A light
/// whose blocks fit another position clearly better than its own is miswired. Lights whose
/// positions look alike, as under a diffuser, are named instead of guessed. Objects in view
/// throw shadows that no smooth surface has, and then no position fits well: the ratio of two
/// misfits still separates them; a light whose position this does not find either is named.

namespace haarlight::capture {

inline constexpr int kSurveyAcross = 8;  ///< blocks across the picture, and down
inline constexpr int kSurveyBlocks = kSurveyAcross * kSurveyAcross;

/// One light's picture with the dark one subtracted.
struct LightResponse {
  double signal = 0.0;                              ///< mean of all pixels, counts
  double sigma = 0.0;                               ///< of it
  std::array<double, kSurveyBlocks> blocks{};       ///< means of the blocks, row by row
  std::array<double, kSurveyBlocks> block_sigma{};  ///< of them
};

struct SurveyOptions {
  double dead_below = 0.05;  ///< of the expected signal
  double dim_below = 0.7;
};

struct LightSurvey {
  std::vector<int> dead;
  std::vector<int> dim;          ///< dim, not dead
  std::vector<int> unseen;       ///< expected signal below 10 sigma: no verdict
  std::vector<int> miswired;     ///< shines from the position of ...
  std::vector<int> miswired_to;  ///< ... this light
  std::vector<double> power;     ///< relative; 0 = dead or unseen
  double power_sigma = 0.0;      ///< median over the good lights: counting noise and fit
  /// Lights whose position looks like a neighbour's: a swap with it would go undetected.
  std::vector<int> alike;
  /// Lights that fit neither their own position nor another clearly better: nothing is known of
  /// their wiring.
  std::vector<int> unplaced;
  bool can_see_wiring = false;  ///< lights were seen, and none is alike or unplaced
};

/// @param responses  one per light of the rig
/// @param camera     index of the camera used
[[nodiscard]] LightSurvey survey_lights(const Rig& rig, int camera,
                                        std::span<const LightResponse> responses,
                                        const SurveyOptions& options = {});

/// Expected signal of each light in each block of the picture, up to a factor; 0: no plane.
[[nodiscard]] std::vector<std::array<double, kSurveyBlocks>> expected_blocks(const Rig& rig,
                                                                             int camera);
/// Expected mean signal of each light over the picture, up to a factor.
[[nodiscard]] std::vector<double> expected_signals(const Rig& rig, int camera);

}  // namespace haarlight::capture
