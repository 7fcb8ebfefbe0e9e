// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "haarlight/relight/reflectance/formats/reflectance.h"

/// @file
/// The inner loops of a fit whose directions differ from pixel to pixel. Sums are float, in the
/// order of the lights, a product added unrounded where the machine can (lanes.inc): the same
/// bits for every vector width with such an instruction.

namespace haarlight::relight {

/// Pixels of a row processed together.
inline constexpr std::size_t kNearBlock = 32;
/// Lights whose columns are computed together: 24 kB of them stay in the L1 cache, with the
/// sums.
inline constexpr std::size_t kNearChunk = 16;
/// Pixels over which an interpolated matrix is linear.
inline constexpr std::size_t kNearStep = 16;

/// Positions of a block's pixels in the picture's frame, mm.
struct NearBlock {
  alignas(64) std::array<float, kNearBlock> x{};
  alignas(64) std::array<float, kNearBlock> y{};
  alignas(64) std::array<float, kNearBlock> z{};
};

/// One light in the picture's frame.
struct NearSource {
  float x = 0.0F;
  float y = 0.0F;
  float z = 0.0F;
  std::array<float, 3> axis{};  ///< unit, direction of emission
  float mu = 0.0F;
  float scale = 1.0F;  ///< gain = scale * r^2 / cos^mu, from 16-bit codes to fitted values
};

/// The form of the fit.
struct NearForm {
  ReflectanceBasis basis = ReflectanceBasis::hsh;  ///< ptm or hsh
  int n_terms = 9;
  bool is_coded = true;  ///< values become sRGB after their gain
};

/// Columns of the problem: terms and then three values, each padded to a multiple of three.
[[nodiscard]] constexpr std::size_t near_terms_padded(int n_terms) {
  return (static_cast<std::size_t>(n_terms) + 2) / 3 * 3;
}

/// Terms of a light seen from each pixel (zero beyond n_terms, and where the light emits away
/// from it), and the fitted values: what the light's pictures would hold at the reference
/// distance. Terms are within 1e-6; the sRGB curve within 1e-5 of white below 1, 2e-5 up to 4,
/// where it ends.
/// @param codes    (kNearBlock, 3)
/// @param columns  (near_terms_padded(n_terms) + 3, kNearBlock)
void near_columns(const NearForm& form, const NearSource& light, const NearBlock& block,
                  const std::uint16_t* codes, float* columns);

/// A light's gains at a block's pixels, (kNearBlock).
void near_gains(const NearSource& light, const NearBlock& block, float* gains);
/// The values alone, codes times gains. @param values  (3, kNearBlock)
void near_values(const float* gains, const std::uint16_t* codes, bool is_coded, float* values);
/// Gains that grow by more along a block are not approximated by a parabola: up to here r^2 /
/// cos differs from one by less than 3e-5.
inline constexpr float kMostBend = 1.25F;
/// Whether parabolas are too coarse for a light's gains anywhere along a row.
/// @param gains  (2 * n_blocks + 1), every half block
[[nodiscard]] bool has_rough_gains(const float* gains, std::size_t n_blocks);
/// Values of some lights with the parabola through three gains of each: at the block's start,
/// middle and end.
/// @param gains   a light's three, gain_stride apart from light to light
/// @param codes   (kNearBlock, 3) of a light, code_stride apart
/// @param values  (n_lights, 3, kNearBlock)
void bent_near_values(const float* gains, std::size_t gain_stride, const std::uint16_t* codes,
                      std::size_t code_stride, std::size_t n_lights, bool is_coded,
                      float* values);

/// sums[i][j] += sum over the chunk's lights of column i times column j, for terms i and
/// columns j with j's triple not before i's.
/// @param columns  (n_lights, n_padded + 3, kNearBlock)
/// @param sums     (n_padded, n_padded + 3, kNearBlock)
void add_near_products(const float* columns, std::size_t n_lights, std::size_t n_padded,
                       float* sums);

/// Each pixel's coefficients: (A + diag(ridge)) c = b from its sums, in double. A term that the
/// lights do not determine is left out.
/// @param planes  (3 * n_terms, kNearBlock), terms of R, of G, of B
void solve_near(const float* sums, const double* ridge, int n_terms, float* planes);

/// planes[c][i] += sum over the lights of (starts[l][i] + t steps[l][i]) values[l][c] for
/// kNearStep pixels, whose t goes from 0 to 1.
/// @param starts  (n_lights, n_terms), as steps
/// @param values  (n_lights, 3, kNearBlock)
/// @param planes  (3, n_terms, kNearBlock)
void add_near_between(const float* starts, const float* steps, int n_terms,
                      std::size_t n_lights, const float* values, float* planes);

/// out[k] = sum over i of weights[i] * from[i][k], n numbers, n a multiple of kNearStep.
void mix_near(const std::array<const float*, 4>& from, const std::array<float, 4>& weights,
              std::size_t n, float* out);
/// out = a - b, n numbers, n a multiple of kNearStep.
void subtract_near(const float* a, const float* b, std::size_t n, float* out);

}  // namespace haarlight::relight
