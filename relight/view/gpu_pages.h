// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <string>

#include "haarlight/relight/basis/basis_file.h"

/// @file
/// A basis file's pictures in a form for the GPU: cut into square pages of small integers,
/// empty ones left out. A picture is what one number of the lighting is multiplied with: a
/// coefficient's, or, in a lossless file, a light's; or the pixels' gains or shifts. Layout of
/// the bytes: docs/reference/http-api.md, "The viewer's server".
///
/// A value that does not fit the page's integers is split over several pages, its digits: value
/// = sum over d of digit_d * base^d with base 256 (or 65536 for gains) and digits from -base/2
/// to base/2 - 1. Sums of pages are linear, so a digit is one more page whose factor is base^d
/// times as large, and nothing is rounded.

namespace haarlight::relight {

/// Tiles [first, last] of the file, row by row.
struct TileRun {
  int first = 0;
  int last = 0;
};

/// Pixels along a page's side: the file's tile, rounded up to a multiple of 4, so that four
/// neighbours of a row share a texel. Values outside the tile are 0.
[[nodiscard]] int page_side(const BasisHeader& header);

/// The power of two that a lossless file's values are divided by before they become
/// half-precision numbers, such that the largest is in [0.5, 1); 1 for other files.
[[nodiscard]] double half_scale(const BasisHeader& header);

/// Pictures of one group: 8-bit integers, multiples of step * 2^-shift; for a lossless file
/// half-precision floats, to be multiplied by half_scale (relative error 2^-11, and 2^-25 of
/// the peak for values below 6e-5 of it).
/// @throws Error  no such channel, group or tile; more than kMostPageBytes; damaged blocks
[[nodiscard]] std::string coefficient_pages(const BasisFile& basis, int channel, int group,
                                            TileRun tiles);

/// The clean plate's gains as 16-bit integers, multiples of gain_step, as picture 0.
[[nodiscard]] std::string gain_pages(const BasisFile& basis, int channel, TileRun tiles);

/// The tiles' clean-plate polynomials a[tile][j][t] (tile_plate.h): 32-bit floats,
/// little-endian.
[[nodiscard]] std::string plate_polynomials(const BasisFile& basis, int channel, TileRun tiles);

/// Every tile's shifts as 8-bit integers, as picture 0; tiles without any are left out.
[[nodiscard]] std::string shift_pages(const BasisFile& basis, int channel, TileRun tiles);

/// Size limit of a response with several tiles, digits beyond the first not counted.
inline constexpr std::size_t kMostPageBytes = std::size_t{32} << 20U;

}  // namespace haarlight::relight
