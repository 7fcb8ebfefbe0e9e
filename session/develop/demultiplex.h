// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "core/rig/pattern_inverse.h"
#include "haarlight/core/image.h"
#include "haarlight/session/develop/develop_options.h"
#include "haarlight/session/session.h"

/// @file
/// Matches a session's shots with the pattern parameters they were made with, and turns them
/// into single lights strip by strip: the step of develop for captures that light several LEDs
/// at once.

namespace haarlight::session {

/// The patterns of a session in the order of its pattern parameters.
struct MatchedShots {
  std::vector<std::size_t> order;  ///< shot j of the inverse: its index in `patterns`
  PatternInverse inverse;
};

/// @param patterns  what the light shots lit, each once, only levels above 0, sorted by light
/// @throws Error  a shot of the parameters that is missing, a shot not in the parameters,
///                uneven levels, patterns that cannot separate the lights; names session.json
[[nodiscard]] MatchedShots match_shots(const Session& session,
                                       const std::vector<std::vector<LightLevel>>& patterns);

/// Rows of one picture per shot become rows of one picture per light, in place.
/// @param power     relative power of each light, divided out
/// @param plate     clean plate; may be empty (light is distributed evenly)
/// @param y0        the first of these rows in the whole picture, for the plate
/// @param pictures  (rows, width, channels), one per shot; then one per light
void demultiplex_rows(const PatternInverse& inverse, const std::vector<double>& power,
                      const PlatePixels& plate, int y0, std::vector<Image<float>>& pictures);

/// Variances of the shots' pictures become those of the lights', in place: independent noise by
/// the squares of the inverse's rows, and noise common to all shots (the dark frames' own) by
/// its sum, (sum_j A_kj s_j)^2.
/// @param common_sigma  s, one per shot
/// @param variances     (rows, width, channels), one per shot, below 0: unknown (clipped in
/// every exposure); then one per light, -1 where a shot that it needs is unknown
void demultiplex_variance_rows(const PatternInverse& inverse, const std::vector<double>& power,
                               const PlatePixels& plate, int y0,
                               const std::vector<double>& common_sigma,
                               std::vector<Image<float>>& variances);

}  // namespace haarlight::session
