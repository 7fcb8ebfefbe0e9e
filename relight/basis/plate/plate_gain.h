// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include "relight/basis/plate/counted_rank.h"

/// @file
/// The gain by which a pixel sees the clean plate. Method: docs/numerics/relight.md, "The clean
/// plate".

namespace haarlight::relight {

/// Gains of pixels, one after the other; one per thread.
class PlateGain {
 public:
  /// The gain g of one pixel: the median of T/B over the lights with B > 1e-6 of the pixel's
  /// largest B (of an even number the greater one in the middle); 0 when there is none, or when
  /// T - g B has more energy than T.
  /// @param t  finite
  [[nodiscard]] float operator()(std::span<const float> t, std::span<const float> b);

 private:
  CountedRank rank_;
  std::vector<float> ratios_;
};

}  // namespace haarlight::relight
