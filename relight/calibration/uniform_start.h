// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "relight/calibration/target_samples.h"

/// @file
/// A first guess of the lights' positions: each on its own, assuming a uniform albedo, which
/// nearly holds for a sheet of paper; later stages drop the assumption.

namespace haarlight::relight {

/// Robust fit of ln I by (position, power), one light after the other, from its position in
/// `start` and from a few heights over the brightest part; the best is kept. Lights without 6
/// used samples keep their start. Powers of mean 1. Axes and exponents are those of `start`.
[[nodiscard]] std::vector<NearLight> uniform_albedo_start(const TargetSamples& samples,
                                                          std::vector<NearLight> start);

}  // namespace haarlight::relight
