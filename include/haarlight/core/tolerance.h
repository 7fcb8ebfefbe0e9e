// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "haarlight/core/image.h"

/// @file
/// How accurate a result must be, and how accurate it is.

namespace haarlight {

/// What the user requests. A limit of 0 means exact; infinity means no limit.
struct Tolerance {
  double relative_l2 = 0.0;  ///< ||result - truth||_2 / ||truth||_2 over the whole result
  double worst_pixel = 0.0;  ///< largest |result - truth| of a value, as a fraction of the peak
};

/// What was achieved against a reference of the same shape.
struct Achieved {
  double relative_l2 = 0.0;
  double worst_pixel = 0.0;  ///< largest absolute difference / largest absolute reference value
  double psnr_db = 0.0;  ///< with the reference's 99.9th percentile as the peak; inf if equal
};

/// Compares value by value in double. A zero reference gives relative errors of 0 when the
/// result is zero too, and infinity otherwise.
/// @param result, reference  equal sizes
[[nodiscard]] Achieved compare(std::span<const float> result, std::span<const float> reference);

}  // namespace haarlight
