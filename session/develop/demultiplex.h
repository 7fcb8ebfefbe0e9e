// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/rig/pattern_inverse.h"
#include "session/session.h"

/// @file
/// A session's shots, matched with the recipe they were made by, and turned into single lights
/// strip by strip: the step of develop for captures that light several LEDs at once.

namespace haarlight {

/// The clean plate, pixel by pixel: how the light of a shot is shared out among its LEDs.
struct PlatePixels {
  /// Writes (x1 - x0, n_lights) of row y, not negative. Called from several threads.
  std::function<void(int y, int x0, int x1, std::span<float> out)> read;
  std::string key;  ///< what it depends on: a part of the light stack's key
  [[nodiscard]] bool is_empty() const { return !read; }
};

/// The patterns of a session as its recipe counts them.
struct MatchedShots {
  std::vector<std::size_t> order;  ///< of shot j of the inverse: its place in `patterns`
  PatternInverse inverse;
};

/// @param patterns  what the light shots lit, each once, levels above 0 only, sorted by light
/// @throws Error  a shot of the recipe that is missing, one it does not have, uneven levels,
///                patterns that cannot tell the lights apart; names session.json
[[nodiscard]] MatchedShots match_shots(const Session& session,
                                       const std::vector<std::vector<LightLevel>>& patterns);

/// Rows of one picture a shot become rows of one picture a light, in place.
/// @param power     relative power of each light, divided out
/// @param plate     may be empty (light is shared out evenly)
/// @param y0        the rows' first row in the whole picture, for the plate
/// @param pictures  (rows, width, channels), one a shot; then one a light
void demultiplex_rows(const PatternInverse& inverse, const std::vector<double>& power,
                      const PlatePixels& plate, int y0, std::vector<Image<float>>& pictures);

/// Variances of the shots' pictures become those of the lights', in place: independent noise by
/// the squares of the inverse's rows, and noise that all shots share (the dark frames' own) by
/// its sum, (sum_j A_kj s_j)^2.
/// @param common_sigma  s, one a shot
/// @param variances     (rows, width, channels), one a shot, below 0: not known (clipped in
/// every
///                      exposure); then one a light, -1 where a shot that it needs is not known
void demultiplex_variance_rows(const PatternInverse& inverse, const std::vector<double>& power,
                               const PlatePixels& plate, int y0,
                               const std::vector<double>& common_sigma,
                               std::vector<Image<float>>& variances);

}  // namespace haarlight
