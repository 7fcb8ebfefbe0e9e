// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <numbers>

#include "haarlight/core/error.h"

/// @file
/// The area that a straight line cuts off a disk, as a fraction of the disk's. Relative error at
/// most 1e-14 in theta and in t, however small (docs/numerics/soft-shadow.md). Pure.

namespace haarlight::render {

/// Of a segment of central angle `theta`:
///
///     V = (theta - sin theta) / (2 pi)
///
/// @param theta  0..2 pi
[[nodiscard]] inline double segment_fraction(double theta) {
  constexpr double kSeriesBelow = 0.5;  // the difference above loses 6/theta^2 roundings
  if (theta < kSeriesBelow) {
    // theta^3/3! - theta^5/5! + ... to theta^15/15!: what is left out is below 2e-18 of it.
    const double q = theta * theta;
    const double sum =
        1.0 -
        q / 20.0 *
            (1.0 -
             q / 42.0 *
                 (1.0 - q / 72.0 * (1.0 - q / 110.0 * (1.0 - q / 156.0 * (1.0 - q / 210.0)))));
    return theta * q / (12.0 * std::numbers::pi) * sum;
  }
  return (theta - std::sin(theta)) / (2.0 * std::numbers::pi);
}

/// Of a segment whose height is the fraction t of the diameter: the exact V(t),
///
///     theta = 4 asin(sqrt t),   V = (arccos(1 - 2t) - 2 (1 - 2t) sqrt(t (1 - t))) / pi,
///
/// 16/(3 pi) t^1.5 near 0, and V(1 - t) = 1 - V(t).
/// @param t  0..1. @throws ContractViolation  beyond it, or not a number
[[nodiscard]] inline double segment_fraction_of_height(double t) {
  HAARLIGHT_EXPECTS(t >= 0.0 && t <= 1.0, "a fraction of the diameter, 0..1");
  return t <= 0.5 ? segment_fraction(4.0 * std::asin(std::sqrt(t)))
                  : 1.0 - segment_fraction(4.0 * std::asin(std::sqrt(1.0 - t)));
}

/// Of what lies beyond a line at the signed distance s from the centre, in units of the radius:
///
///     V = (arccos s - s sqrt(1 - s^2)) / pi
///
/// A rounding of s near 1 is one of 1 - s: who knows 1 - s itself calls
/// segment_fraction_of_height((1 - s)/2).
/// @param s  -1..1. @throws ContractViolation  beyond it, or not a number
[[nodiscard]] inline double segment_fraction_beyond(double s) {
  HAARLIGHT_EXPECTS(s >= -1.0 && s <= 1.0, "a distance in units of the radius, -1..1");
  return segment_fraction_of_height(0.5 * (1.0 - s));
}

}  // namespace haarlight::render
