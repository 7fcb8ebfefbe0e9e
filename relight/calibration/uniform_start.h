// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "relight/calibration/target_samples.h"

/// @file
/// A first guess of where lights are: each on its own, as if the target's albedo were the same
/// everywhere. What a sheet of paper nearly is; the stages after it drop the assumption.

namespace haarlight {

/// Robust fit of ln I by (place, power), one light after the other, from its place in
/// `start` and from a few heights over the brightest part; the best is kept. Lights without 6
/// used samples keep their start. Powers of mean 1. Axes and exponents are those of `start`.
[[nodiscard]] std::vector<NearLight> uniform_albedo_start(const TargetSamples& samples,
                                                          std::vector<NearLight> start);

}  // namespace haarlight
