// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <span>

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

/// A part of the unit interval that is cut in proportion to weights, and where in it.
struct CutUnit {
  std::size_t index = 0;
  double within = 0.0;  ///< 0..1
};

/// The part that `u` is in: of weight 0 none is ever found.
/// @param up_to  sums of the weights up to and with each, the last one above 0
/// @param u      in [0, 1)
[[nodiscard]] inline CutUnit cut_unit(std::span<const double> up_to, double u) {
  const double sum = u * up_to.back();
  // The last sum may be reached by rounding; the part before it that has a weight is meant.
  const auto found = std::min(std::ranges::upper_bound(up_to, sum),
                              std::ranges::lower_bound(up_to, up_to.back()));
  const auto index = static_cast<std::size_t>(found - up_to.begin());
  const double before = index == 0 ? 0.0 : up_to[index - 1];
  return {.index = index,
          .within = std::clamp((sum - before) / (up_to[index] - before), 0.0, 1.0)};
}

}  // namespace haarlight::render
