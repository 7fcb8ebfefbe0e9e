// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "haarlight/core/image.h"

/// @file
/// The best division of a picture's pixels into two: a minimal cut of the graph that the pixels
/// and their neighbours are [Boykov04], which is the exact minimum.

namespace haarlight::relight {

/// All (height, width), >= 0.
struct TwoLabels {
  Image<float> stays;  ///< what it costs that a pixel stays
  Image<float> moves;
  Image<float> right;  ///< what it costs to part (y, x) from (y, x + 1); 0: not joined
  Image<float> down;   ///< from (y + 1, x)
};

/// 1 where a pixel moves, so that the sum of all costs is least.
[[nodiscard]] Image<std::uint8_t> best_division(const TwoLabels& costs);

}  // namespace haarlight::relight
