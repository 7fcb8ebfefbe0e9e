// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "haarlight/core/image.h"
#include "render/soft_shadow/soft_shadow.h"

/// @file
/// What an approximation of soft shadows is off by beside the exact values, over the pixels of a
/// picture.

namespace haarlight::apps {

/// Over all lights. Only values whose exact one is exact are compared.
struct ShadowErrors {
  std::int64_t n_compared = 0;
  std::int64_t n_penumbra = 0;  ///< of these: 0 < exact < 1
  double mean = 0.0;            ///< of |error| over these
  double at_99 = 0.0;
  double worst = 0.0;       ///< over all that are compared
  double mean_error = 0.0;  ///< with its sign: too light is positive
  /// Pixels that are on the wrong side of the umbra's, or of the penumbra's, border: how far the
  /// farthest is from that border, in steps to one of eight neighbours.
  int umbra_border_pixels = 0;
  int penumbra_border_pixels = 0;
};

class ShadowComparison {
 public:
  /// @param pixels  of each value, in a picture of `width` x `height`
  ShadowComparison(std::vector<std::size_t> pixels, int width, int height);

  /// Adds one light. @return  the error, 0 where nothing is seen or compared
  Image<float> add(const std::vector<render::LightShadow>& values,
                   const std::vector<render::LightShadow>& exact);

  [[nodiscard]] ShadowErrors errors() const;

 private:
  std::vector<std::size_t> pixels_;
  int width_;
  int height_;
  ShadowErrors all_;
  double sum_ = 0.0;
  std::vector<float> penumbra_errors_;
};

}  // namespace haarlight::apps
