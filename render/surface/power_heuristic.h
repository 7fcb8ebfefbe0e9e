// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace haarlight::render {

/// The weight of a density against another that could have found the same [Veach95], eq. (14)
/// with exponent 2. Neither is squared: that would overflow at 1e155. @param own  above 0
[[nodiscard]] inline double power_heuristic(double own, double other) {
  const double ratio = other / own;
  return 1.0 / (1.0 + ratio * ratio);
}

}  // namespace haarlight::render
