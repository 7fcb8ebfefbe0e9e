// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "relight/basis/coder/quantiser.h"

/// @file
/// One coder for every basis of the comparison, so that sizes are comparable: the dead-zone
/// quantiser of compress, whole numbers plane by plane (a plane: one coefficient over all
/// pixels of a tile), split into bytes, zstd. Also counts the coefficients a threshold keeps.

namespace haarlight::relight {

/// Values (n_pixels, n_coefficients) of the first `n_kept` coefficients to multiples of `step`,
/// in place; the others become 0.
/// @return  nonzero numbers
std::uint64_t quantise_values(std::span<float> values, std::size_t n_coefficients,
                              std::size_t n_kept, float step);
/// The same, with kept values (|c| >= threshold) unchanged.
std::uint64_t threshold_values(std::span<float> values, std::size_t n_coefficients,
                               std::size_t n_kept, float threshold);

/// Bytes of the packed planes, of values from quantise_values(): 64 coefficients per block, 16
/// bits per number, 32 where a block needs them; zstd level 9. The blocks are packed side by
/// side.
/// @param pixel_order  order of the pixels within a plane; empty: unchanged
[[nodiscard]] std::uint64_t packed_bytes(std::span<const float> values,
                                         std::size_t n_coefficients, std::size_t n_kept,
                                         float step, std::span<const int> pixel_order);
/// To half floats in units of one power of two, which brings the largest into [2^14, 2^15].
void round_to_halves(std::span<float> values);
/// Bytes of values from round_to_halves(): byte planes, zstd level 9, and the exponent.
[[nodiscard]] std::uint64_t packed_half_bytes(std::span<const float> values);

/// What a threshold leaves of a set of coefficients, from a histogram: exact at bin borders (64
/// per octave), linear in between.
class CoefficientCurve {
 public:
  CoefficientCurve() = default;
  explicit CoefficientCurve(const MagnitudeHistogram& histogram);
  /// Energy of all coefficients.
  [[nodiscard]] double energy() const noexcept { return energy_; }
  /// The largest threshold below which no more than `allowed` energy lies.
  [[nodiscard]] double threshold_for_energy(double allowed) const;
  /// The threshold that keeps `n`; 0 where fewer are nonzero.
  [[nodiscard]] double threshold_for_count(double n) const;
  /// Nonzero coefficients at or above the threshold.
  [[nodiscard]] double count_from(double threshold) const;
  /// At or above every magnitude.
  [[nodiscard]] double largest() const noexcept;

 private:
  struct Bin {
    double lower;
    double upper;
    double count;
    double energy;
  };
  std::vector<Bin> bins_;  ///< ascending, zeros left out
  double energy_ = 0.0;
};

}  // namespace haarlight::relight
