// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "haarlight/relight/basis/basis_file.h"

/// @file
/// What encoder and decoder of BasisCoding::integers must do identically to the last bit: the
/// clean plate's prediction, rounded to whole units (the S-transform is the basis' own,
/// FixedBasis::forward_integers). Every operation is one of IEEE double in the order specified
/// in docs/reference/basis-format.md; no fused multiply-add.

namespace haarlight::relight {

/// n = round(T / unit), T the light transport matrix, is stored as n - P with P = floor(gain d
/// / unit + 1/2), d the plate's direction at the pixel (tile_plate.h).
class IntegerPrediction {
 public:
  /// Borrows all but `rect`. @param tile_plate  PixelBlock::plate
  IntegerPrediction(const BasisHeader& header, std::span<const float> vectors,
                    const TileRect& rect, std::span<const float> tile_plate);
  /// P of one pixel, (n_lights); until the next call.
  /// @param gain  in gain steps
  [[nodiscard]] std::span<const std::int32_t> of(std::size_t pixel, std::int32_t gain);

 private:
  const BasisHeader& header_;
  std::span<const float> vectors_;
  std::span<const float> tile_plate_;
  std::vector<double> terms_;
  std::size_t n_terms_ = 1;
  std::vector<double> direction_;
  std::vector<std::int32_t> predicted_;
};

/// Range of a light's values. What is stored of them fits 32 bits; a damaged file's 32 bits
/// never overflow 64.
inline constexpr std::int32_t kLargestInteger = 1 << 24;

}  // namespace haarlight::relight
