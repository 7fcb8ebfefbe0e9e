// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "relight/basis/light_basis.h"

/// @file
/// Bases that transform every row of a grid, then every column: the DCT and the standard Haar
/// wavelet. Docs: docs/numerics/bases.md; to the last index in docs/reference/basis-format.md.

namespace haarlight::relight {

/// Orthonormal 2-D DCT-II of each grid [Ahmed74]:
///     C[i][k] = sqrt((i == 0 ? 1 : 2) / n) cos(pi (2 k + 1) i / (2 n))
/// along both sides; any number of rows and columns. Floats are transformed in doubles and
/// rounded once. O(rows cols (rows + cols)).
[[nodiscard]] std::shared_ptr<const FixedBasis> make_dct_basis(const HaarGrid& grid,
                                                               int n_lights);

/// Haar along every row through all levels, then along every column: sums before details, each
/// (a +- b) / sqrt 2. Rows and columns are powers of two.
[[nodiscard]] std::shared_ptr<const FixedBasis> make_standard_haar_basis(const HaarGrid& grid,
                                                                         int n_lights);

/// Indices row * cols + col by the bit length of max(row, col), then by index; and where each
/// group ends: indices below 8 along both sides, then a group per bit length.
[[nodiscard]] std::vector<int> dyadic_order(const HaarGrid& grid);
[[nodiscard]] std::vector<int> dyadic_group_ends(const HaarGrid& grid);

/// `of_grid`, of one grid's indices, for every grid: offsets by the grids before it.
[[nodiscard]] std::vector<int> for_each_grid(const std::vector<int>& of_grid, int grid_size,
                                             int n_lights);

}  // namespace haarlight::relight
