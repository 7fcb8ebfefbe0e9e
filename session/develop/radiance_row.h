// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

/// @file
/// A row of one exposure's samples as radiance, in vectors: what merge_exposures() makes of a
/// single sample, to the bit. Pure; safe from any thread.

namespace haarlight::session {

/// What a frame's samples share.
struct FrameScale {
  double electrons_per_step = 1.0;
  double per_unit = 1.0;     ///< electrons of radiance 1
  double clip_dn = 0.0;      ///< samples from here on only mean "at least"
  double clip_linear = 0.0;  ///< the same in linear steps above black
};

/// A row's samples.
struct SampleRow {
  std::span<const float> dn;      ///< as stored
  std::span<const float> linear;  ///< steps above black
  std::span<const float> dark;    ///< to subtract, in steps; empty: nothing
  std::span<const double> flat;   ///< factor on FrameScale::per_unit; empty: 1
};

/// values = (linear - dark) electrons_per_step / (per_unit flat); of a clipped sample at least
/// what the clip level gives.
/// @return  how many are lower bounds
std::size_t radiance_of_row(const FrameScale& scale, const SampleRow& row, float* values);
/// 1 where the radiance is a lower bound, else 0.
void mark_clipped(const FrameScale& scale, const SampleRow& row, std::uint8_t* marks);

/// Stored samples as floats.
void widen(std::span<const std::uint8_t> samples, float* to);
void widen(std::span<const std::uint16_t> samples, float* to);

}  // namespace haarlight::session
