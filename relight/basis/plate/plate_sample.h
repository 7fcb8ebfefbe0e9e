// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "haarlight/core/rig/rig.h"
#include "haarlight/session/develop/develop_options.h"

/// @file
/// Parts of the computed clean plate, for predictions that need no picture.

namespace haarlight::relight {

/// At most `max_pixels` pixels, spread evenly over the first camera's picture of the first plane.
/// @return  (n_pixels, n_lights)
/// @throws Error  as ComputedPlate
[[nodiscard]] std::vector<float> sample_plate(const Rig& rig, int max_pixels);

/// The plate for shared light as develop() will use it, by rows; empty where the rig has no plane
/// or no camera of this size.
[[nodiscard]] session::PlatePixels computed_pixels(const Rig& rig, int width, int height);

}  // namespace haarlight::relight
