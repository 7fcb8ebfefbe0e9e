// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <span>
#include <vector>

/// @file
/// Synthesis of a grid's lights from its wavelets, level by level; private to the pattern
/// inverse, which applies it to values or to their variances.

namespace haarlight {

/// @param x    (n, n, width), n a power of two: wavelets before, lights after
/// @param mix  (mean, dx, dy, dxy, top left, top right, low left, low right): four lights from
///             four wavelets
template <class Mix>
void synthesise_wavelets(int n, std::span<double> x, std::size_t width, Mix mix) {
  const auto side = static_cast<std::size_t>(n);
  std::vector<double> old(x.size());
  for (std::size_t h = 1; h < side; h *= 2) {
    for (std::size_t row = 0; row < 2 * h; ++row) {
      std::copy_n(x.data() + row * side * width, 2 * h * width,
                  old.data() + row * side * width);
    }
    for (std::size_t row = 0; row < h; ++row) {
      for (std::size_t col = 0; col < h; ++col) {
        const double* mean = old.data() + (row * side + col) * width;
        const double* dx = mean + h * width;
        const double* dy = mean + h * side * width;
        const double* dxy = dy + h * width;
        double* top = x.data() + (2 * row * side + 2 * col) * width;
        double* low = top + side * width;
        for (std::size_t i = 0; i < width; ++i) {
          mix(mean[i], dx[i], dy[i], dxy[i], top[i], top[width + i], low[i], low[width + i]);
        }
      }
    }
  }
}

}  // namespace haarlight
