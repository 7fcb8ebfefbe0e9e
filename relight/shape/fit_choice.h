// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "haarlight/core/image.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/shape/photometric_stereo.h"

/// @file
/// Chooses the robust fit for a capture: the one that best predicts held-out lights. Measured
/// against true normals in docs/numerics/shape.md, "Which fit".

namespace haarlight::relight {

struct FitScore {
  LambertOptions fit{};
  std::string name;
  /// Mean over sampled pixels of the median |residual| of lights left out, over the albedo.
  double held_out = 1.0;
};

/// Each quarter of the lights, made of whole groups of neighbours, is left out in turn.
/// @param points  as photometric_stereo()
/// @param good    (height, width) 1: a pixel may be sampled; empty: all
/// @return  the candidates, best first; at least one
[[nodiscard]] std::vector<FitScore> score_fits(const StackSource& stack,
                                               const StereoLights& lights,
                                               ImageView<const float> points,
                                               ImageView<const std::uint8_t> good,
                                               const StereoOptions& options);

}  // namespace haarlight::relight
