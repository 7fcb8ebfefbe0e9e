// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "haarlight/core/image.h"

/// @file
/// How much of a surface's height is one slow bow. Near lights of which only directions are
/// known make every surface bow, and the heights alone cannot distinguish that bow from a real
/// one.

namespace haarlight::relight {

struct HeightBow {
  double bow = 0.0;   ///< largest minus smallest of the quadratic that fits the heights best
  double rest = 0.0;  ///< largest minus smallest of the heights without it
};

/// Least-squares quadratic in the pixel's position; its linear part is included in `bow`. Both
/// 0 for fewer than six known pixels.
/// @param height    (height, width)
/// @param is_known  (height, width)
[[nodiscard]] HeightBow height_bow(ImageView<const float> height,
                                   ImageView<const std::uint8_t> is_known);

}  // namespace haarlight::relight
