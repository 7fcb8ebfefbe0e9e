// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

/// @file
/// The 2-D orthonormal nonstandard Haar transform of an n x n array, and its integer version.
/// Source: Haar (1910) as used by [Ng03] for lighting; layout and signs of
/// data/golden/haar.json, which are PyWavelets' `coeffs_to_array(wavedec2(x, 'haar'))`. Notes:
/// docs/numerics/haar.md.
///
/// One level turns the blocks a b / c d of x into
///     LL = (a + b + c + d)/2   top left       X = (a - b + c - d)/2   top right
///     Y  = (a + b - c - d)/2   bottom left    D = (a - b - c + d)/2   bottom right
/// and goes on with LL down to 1 x 1. All taps are +-1/2: sums of squares are kept, and
/// integers below 2^(53 - 2 log2 n) give exact coefficients in double.

namespace haarlight::relight {

/// True for 1, 2, 4, ... 1024: the sizes the plain transforms take.
[[nodiscard]] bool is_haar_size(int n) noexcept;

/// Lights in rows and columns. Where these differ or are not powers of two, the unbalanced Haar
/// transform is used [Girardi97]: neighbours are paired, the last of an odd number waits for
/// the next level, and a pair of groups of a and b lights with normalised sums x and y becomes
///     s = (sqrt(a) x + sqrt(b) y) / sqrt(a + b),   d = (sqrt(b) x - sqrt(a) y) / sqrt(a + b),
/// along x, then along y. It is orthonormal, needs as many coefficients as there are lights
/// (padding with zeros would need up to four times as many), gives only the mean for a
/// constant, and is the transform above for an n x n grid.
struct HaarGrid {
  int rows = 0;
  int cols = 0;
  [[nodiscard]] int size() const noexcept { return rows * cols; }
  /// Both are the same power of two.
  [[nodiscard]] bool is_plain() const noexcept { return rows == cols && is_haar_size(rows); }
  /// Sides of 1 to 1024.
  [[nodiscard]] bool is_valid() const noexcept;
  friend bool operator==(const HaarGrid&, const HaarGrid&) = default;
};

/// In place on every rows x cols array of x, one after the other. O(size of x). Pure except for
/// `x`; safe from any thread.
/// @throws ContractViolation  an invalid grid, or x not of whole grids
void haar_forward(std::span<float> x, const HaarGrid& grid);
void haar_forward(std::span<double> x, const HaarGrid& grid);
/// The exact inverse up to rounding: 2 log2(n) additions per value of n x n.
void haar_inverse(std::span<float> x, const HaarGrid& grid);
void haar_inverse(std::span<double> x, const HaarGrid& grid);
/// One value of the inverse of one array, the same bits: O(log n).
/// @throws ContractViolation  a grid that is not plain, no value of it
[[nodiscard]] double haar_inverse_at(std::span<const double> x, const HaarGrid& grid, int row,
                                     int col);

/// The lossless integer S-transform of every rows x cols array of x: per level along x, then y:
/// d = a - b, s = b + (d >> 1), s first, then d; the last of an odd number is its own s; same
/// layout as above. Values must stay within a quarter of the type's range so that no difference
/// overflows.
void s_transform_forward(std::span<std::int64_t> x, const HaarGrid& grid);
void s_transform_inverse(std::span<std::int64_t> x, const HaarGrid& grid);

/// Indices row * cols + col from coarse to fine: by level (0 for the mean, 1 for the details
/// added by the first inverse step, and so on), within a level by index. The order in which a
/// basis file stores coefficients.
[[nodiscard]] std::vector<int> haar_order(const HaarGrid& grid);

/// That order cut into groups: the coefficients of at least 8 per side together (all of a
/// smaller grid), then one group per level. @return  where each ends
[[nodiscard]] std::vector<int> haar_group_ends(const HaarGrid& grid);

}  // namespace haarlight::relight
