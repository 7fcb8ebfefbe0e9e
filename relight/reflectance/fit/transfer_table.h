// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <vector>

#include "haarlight/core/picture/image_io.h"

/// @file
/// Linear values to coded ones, by a table: for loops over every value of a capture. Pure after
/// construction.

namespace haarlight::relight {

/// Linear interpolation between 16384 nodes over [0, 4]: error below 2e-5 of white (where the
/// sRGB curve bends most, at 0.003). Values below 0 become 0, those above 4 are clamped.
class TransferTable {
 public:
  explicit TransferTable(Transfer transfer);
  [[nodiscard]] float operator()(float linear) const {
    if (table_.empty()) {
      return linear;
    }
    const float at = linear > 0.0F ? (linear < kMost ? linear * kPerUnit : kLast) : 0.0F;
    const auto i = static_cast<std::size_t>(at);
    const float t = at - static_cast<float>(i);
    return table_[i] + t * (table_[i + 1] - table_[i]);
  }

 private:
  static constexpr float kMost = 4.0F;
  static constexpr float kPerUnit = 4096.0F;
  static constexpr float kLast = kMost * kPerUnit;
  std::vector<float> table_;  ///< empty: linear
};

}  // namespace haarlight::relight
