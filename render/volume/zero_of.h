// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

/// @file
/// Where a function that only rises passes zero.

namespace haarlight::render {

/// A point of a function's graph.
struct GraphPoint {
  double x = 0.0;
  double y = 0.0;
};

/// To rounding of the function: by the secant of the ends, of which one that stays is drawn nearer to
/// zero each time (the Illinois rule [Dowell71]), or by halving where that is too slow.
/// @param f      of x, of size 1, does not fall @param low, high  of its graph: low.x <= high.x,
///               low.y <= 0 <= high.y
/// @param first  tried first
template <class Function>
[[nodiscard]] double zero_of(const Function& f, GraphPoint low, GraphPoint high, double first) {
  constexpr double kRounding = 4.0 * std::numeric_limits<double>::epsilon();
  constexpr double kBeside = 2.0 * std::numeric_limits<double>::epsilon();
  constexpr int kMostSteps = 120;
  int side = 0;  // of the end that was moved last
  double width = high.x - low.x;
  for (int step = 0; step < kMostSteps; ++step) {
    double x = step == 0 ? first : low.x - low.y * ((high.x - low.x) / (high.y - low.y));
    constexpr int kSteps = 3;  // in which halving has made an eighth of it
    if (step % kSteps == kSteps - 1) {
      if (high.x - low.x > 0.5 * width) {
        x = 0.5 * (low.x + high.x);
      }
      width = high.x - low.x;
    }
    // A secant that ends at an end: the zero is beside it.
    const double beside = kBeside * std::max(std::abs(low.x), std::abs(high.x));
    if (!(x < high.x)) {
      x = high.x - beside;
    } else if (!(x > low.x)) {
      x = low.x + beside;
    }
    if (!(x > low.x && x < high.x)) {
      x = 0.5 * (low.x + high.x);
    }
    if (!(x > low.x && x < high.x)) {
      return high.x;  // neighbours
    }
    const double y = f(x);
    if (std::abs(y) <= kRounding) {
      return x;
    }
    if (y < 0.0) {
      low = {.x = x, .y = y};
      high.y *= side < 0 ? 0.5 : 1.0;
      side = -1;
    } else {
      high = {.x = x, .y = y};
      low.y *= side > 0 ? 0.5 : 1.0;
      side = 1;
    }
  }
  return high.x;
}

}  // namespace haarlight::render
