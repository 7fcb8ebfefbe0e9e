// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <span>

#include <Eigen/Core>

/// @file
/// Maps of the unit square that keep areas, so that points which are even there stay even.

namespace haarlight::render {

/// The cosine and sine of 2 pi `turns`, to 4e-16: by Taylor's series about the nearest quarter turn and
/// without a branch, as the quadrants of samples are in no order; loops over it become vectors.
/// @param turns  in [-1, 1]
inline void cos_sin_of_turns(double turns, double& cosine, double& sine) {
  const int quarters = static_cast<int>(4.0 * turns + 4.5) - 4;
  const double x = 2.0 * std::numbers::pi * (turns - 0.25 * quarters);
  const double y = x * x;
  const double s =
      x * (1.0 + y * (-1.0 / 6.0 +
                      y * (1.0 / 120.0 + y * (-1.0 / 5040.0 +
                                              y * (1.0 / 362880.0 +
                                                   y * (-1.0 / 39916800.0 +
                                                        y * (1.0 / 6227020800.0 -
                                                             y * (1.0 / 1307674368000.0))))))));
  const double c =
      1.0 +
      y * (-1.0 / 2.0 +
           y * (1.0 / 24.0 +
                y * (-1.0 / 720.0 +
                     y * (1.0 / 40320.0 +
                          y * (-1.0 / 3628800.0 + y * (1.0 / 479001600.0 +
                                                       y * (-1.0 / 87178291200.0 +
                                                            y * (1.0 / 20922789888000.0))))))));
  // By their bits: an odd number of quarters changes the two, and each changes a sign.
  const auto q = static_cast<std::uint64_t>(static_cast<std::int64_t>(quarters));
  const std::uint64_t is_odd = std::uint64_t{0} - (q & 1U);
  const auto s_bits = std::bit_cast<std::uint64_t>(s);
  const auto c_bits = std::bit_cast<std::uint64_t>(c);
  cosine = std::bit_cast<double>(((s_bits & is_odd) | (c_bits & ~is_odd)) ^
                                 (((q + 1U) & 2U) << 62U));
  sine = std::bit_cast<double>(((c_bits & is_odd) | (s_bits & ~is_odd)) ^ ((q & 2U) << 62U));
}

/// (cos, sin) of 2 pi `turns`. @param turns  in [-1, 1]
[[nodiscard]] inline Eigen::Vector2d at_turns(double turns) {
  double cosine = 0.0;
  double sine = 0.0;
  cos_sin_of_turns(turns, cosine, sine);
  return {cosine, sine};
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
  auto found = up_to.begin();
  if (up_to.size() <= 8) {  // a few: without a branch that cannot be foreseen
    for (const double part : up_to) {
      found += part <= sum ? 1 : 0;
    }
  } else {
    found = std::ranges::upper_bound(up_to, sum);
  }
  if (found == up_to.end()) {  // reached by rounding: the last part that has a weight is meant
    found = std::ranges::lower_bound(up_to, up_to.back());
  }
  const auto index = static_cast<std::size_t>(found - up_to.begin());
  const std::size_t has_before = index > 0 ? 1 : 0;
  const double before = static_cast<double>(has_before) * up_to[index - has_before];
  return {.index = index,
          .within = std::clamp((sum - before) / (up_to[index] - before), 0.0, 1.0)};
}

}  // namespace haarlight::render
