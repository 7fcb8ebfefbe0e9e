// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "haarlight/core/image.h"
#include "relight/shadow/plane_offset.h"

/// @file
/// What all of a capture's values together say of its shadow plane. Finding it reads every light
/// at every pixel, of capture and clean plate: kept with the hull.

namespace haarlight::relight {

struct FoundPlane {
  double scale = 0.0;                ///< g of T = g B: light transport matrix, clean plate
  PlaneOffset offset;                ///< where the pixels' light says that the plane is
  Image<std::uint8_t> shows_plane;   ///< (h, w, 1) of the camera; without a rim if detected
  Image<std::uint8_t> shows_object;  ///< (h, w, 1): the plate is lit, something else is seen
};

}  // namespace haarlight::relight
