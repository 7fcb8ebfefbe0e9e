// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "core/image.h"

/// @file
/// How much of a surface's heights is one slow bow. Lights that are known by their directions
/// only and stand near make every surface bow, and nothing in the heights tells that bow from a
/// real one.

namespace haarlight {

struct HeightBow {
  double bow = 0.0;   ///< largest minus smallest of the quadratic that fits the heights best
  double rest = 0.0;  ///< largest minus smallest of the heights without it
};

/// Least squares of a quadratic of the pixel's place, its plane included in `bow` as it is in
/// the heights. Both 0 for fewer than six known pixels.
/// @param height    (height, width)
/// @param is_known  (height, width)
[[nodiscard]] HeightBow height_bow(ImageView<const float> height,
                                   ImageView<const std::uint8_t> is_known);

}  // namespace haarlight
