// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

/// @file
/// Cosine and sine transforms of a picture's rows, any length, by the fast Fourier transform:
/// they solve Poisson's equation with natural boundaries exactly [Makhoul80]; lengths with a
/// large prime factor by Bluestein's chirp, so that no length is slow. O(n log n) per row;
/// errors grow as log n times 2e-16.

namespace haarlight::relight {

enum class RowTransform {
  cosine,          ///< X[k] = sum_j x[j] cos(pi k (j + 1/2) / n), k = 0 .. n - 1
  inverse_cosine,  ///< undoes it
  sine,            ///< X[k] = sum_j x[j] sin(pi (k + 1) (j + 1/2) / n), k = 0 .. n - 1
};

/// Transforms each row of `values`, (height, width), in place.
void transform_rows(std::span<double> values, int height, int width, RowTransform transform);

/// (height, width) to (width, height).
[[nodiscard]] std::vector<double> transposed(std::span<const double> values, int height,
                                             int width);

}  // namespace haarlight::relight
