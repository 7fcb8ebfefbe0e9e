// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <span>

#include <Eigen/Core>

/// @file
/// Maps of the unit square that keep areas, so that points which are even there stay even.

namespace haarlight::render {

/// (cos, sin) of 2 pi `turns`, to 4e-16: by Taylor's series about the nearest quarter turn and without
/// a branch, as the quadrants of samples are in no order. @param turns  in [-1, 1]
[[nodiscard]] inline Eigen::Vector2d at_turns(double turns) {
  const int quarters = static_cast<int>(4.0 * turns + 4.5) - 4;
  const double x = 2.0 * std::numbers::pi * (turns - 0.25 * quarters);
  const double y = x * x;
  const double sine =
      x * (1.0 + y * (-1.0 / 6.0 +
                      y * (1.0 / 120.0 + y * (-1.0 / 5040.0 +
                                              y * (1.0 / 362880.0 +
                                                   y * (-1.0 / 39916800.0 +
                                                        y * (1.0 / 6227020800.0 -
                                                             y * (1.0 / 1307674368000.0))))))));
  const double cosine =
      1.0 +
      y * (-1.0 / 2.0 +
           y * (1.0 / 24.0 +
                y * (-1.0 / 720.0 +
                     y * (1.0 / 40320.0 +
                          y * (-1.0 / 3628800.0 + y * (1.0 / 479001600.0 +
                                                       y * (-1.0 / 87178291200.0 +
                                                            y * (1.0 / 20922789888000.0))))))));
  const std::array<double, 2> parts{cosine, sine};
  constexpr std::array<double, 2> kSign{1.0, -1.0};
  const auto q = static_cast<unsigned>(quarters + 4);
  return {kSign[((q + 1U) >> 1U) & 1U] * parts[q & 1U],
          kSign[(q >> 1U) & 1U] * parts[1U - (q & 1U)]};
}

/// Onto the unit disk: squares about the middle become circles [Shirley97].
[[nodiscard]] inline Eigen::Vector2d concentric_disk(const Eigen::Vector2d& square) {
  const double a = 2.0 * square.x() - 1.0;
  const double b = 2.0 * square.y() - 1.0;
  if (a == 0.0 && b == 0.0) {
    return Eigen::Vector2d::Zero();
  }
  const bool is_wide = std::abs(a) > std::abs(b);
  const double r = is_wide ? a : b;
  return r * at_turns(is_wide ? 0.125 * (b / a) : 0.25 - 0.125 * (a / b));
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
  auto found = std::ranges::upper_bound(up_to, sum);
  if (found == up_to.end()) {  // reached by rounding: the last part that has a weight is meant
    found = std::ranges::lower_bound(up_to, up_to.back());
  }
  const auto index = static_cast<std::size_t>(found - up_to.begin());
  const double before = index == 0 ? 0.0 : up_to[index - 1];
  return {.index = index,
          .within = std::clamp((sum - before) / (up_to[index] - before), 0.0, 1.0)};
}

}  // namespace haarlight::render
