// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <numbers>

#include <Eigen/Core>

/// @file
/// Maps of the unit square that keep areas, so that points which are even there stay even.

namespace haarlight::render {

/// Onto the unit disk: squares about the middle become circles [Shirley97].
[[nodiscard]] inline Eigen::Vector2d concentric_disk(const Eigen::Vector2d& square) {
  const double a = 2.0 * square.x() - 1.0;
  const double b = 2.0 * square.y() - 1.0;
  if (a == 0.0 && b == 0.0) {
    return Eigen::Vector2d::Zero();
  }
  const bool is_wide = std::abs(a) > std::abs(b);
  const double r = is_wide ? a : b;
  const double phi = is_wide ? std::numbers::pi / 4.0 * (b / a)
                             : std::numbers::pi / 2.0 - std::numbers::pi / 4.0 * (a / b);
  return r * Eigen::Vector2d(std::cos(phi), std::sin(phi));
}

}  // namespace haarlight::render
