// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "haarlight/capture/plan/plan.h"

/// @file
/// The order of a plan's shots around its patterns: exposures, repeats, dark frames, sentinels,
/// flat frames. Pure.

namespace haarlight::capture {

/// Predicted duration of a shot in seconds; a change of exposure costs two frames more.
[[nodiscard]] double shot_seconds(const Rig& rig, double exposure_us, double last_exposure_us);

/// Flat frames first. Then for each exposure, each repeat: [dark] [sentinel] patterns in order
/// with darks and sentinels between, and a closing dark and sentinel; after the repeats the
/// exposure's spare darks, which the temperature may bring forward. Between two patterns a dark
/// (sentinel) is due after the given number of patterns, or of predicted seconds since the
/// last, whichever comes first.
/// @param patterns   in the order of display; an empty one is a dark frame
/// @param exposures  microseconds, at least one
[[nodiscard]] std::vector<session::Shot> arrange_shots(
    const PlanSettings& settings, const Rig& rig,
    const std::vector<std::vector<session::LightLevel>>& patterns,
    const std::vector<double>& exposures);

}  // namespace haarlight::capture
