// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/relight/basis/haar.h"
#include "relight/reflectance/fit/light_sample.h"

/// @file
/// What the light-domain Haar basis of basis files would need for the same capture: for
/// comparison with fits. It reproduces only photographed lights, none in between. Pure.

namespace haarlight::relight {

struct HaarSize {
  double psnr_db = 0.0;          ///< mean over the lights, at the lights themselves
  double bytes_per_pixel = 0.0;  ///< index and value of each number kept: 3 bytes
};

/// The `n_kept` largest of a pixel's coefficients over all three channels, unquantised.
/// @param grid  of each face; the sample's lights fill whole grids
[[nodiscard]] HaarSize measure_light_haar(const LightSample& sample, const HaarGrid& grid,
                                          int n_kept);

}  // namespace haarlight::relight
