#pragma once

#include <array>
#include <cstddef>
#include <span>

#include "relight/formats/reflectance.h"

/// @file
/// The inner loops of a fit whose directions differ from pixel to pixel: terms of a light at
/// 64 pixels, and the sums of a small least-squares problem for each of them. Sums are float,
/// in the order of the lights: the same bits with any width of vector.

namespace haarlight {

inline constexpr std::size_t kNearBlock = 64;
/// Lights whose terms are made together: 25 kB of columns stay in the nearest cache.
inline constexpr std::size_t kNearChunk = 8;

/// Places of a block's pixels in the picture's frame, mm.
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
  std::array<float, 3> axis{};  ///< unit, the way it shines
  float mu = 0.0F;
  float scale = 1.0F;  ///< gain = scale * r^2 / cos^mu
};

/// Columns of the problem: terms and then three values, each rounded up to three.
[[nodiscard]] constexpr std::size_t near_terms_padded(int n_terms) {
  return (static_cast<std::size_t>(n_terms) + 2) / 3 * 3;
}

/// Terms of a light seen from each pixel (zero beyond n_terms), and the factor that brings its
/// values to what they would be at the reference distance; 0 where the light shines away.
/// @param terms  (near_terms_padded(n_terms), kNearBlock)
/// @param gain   (kNearBlock)
void near_terms(ReflectanceBasis basis, int n_terms, const NearSource& light,
                const NearBlock& block, float* terms, float* gain);

/// The factor alone.
void near_gain(const NearSource& light, const NearBlock& block, float* gain);

/// sums[i][j] += sum over the chunk's lights of column i times column j, for terms i and
/// columns j with j's triple not before i's.
/// @param columns  (n_lights, n_padded + 3, kNearBlock)
/// @param sums     (n_padded, n_padded + 3, kNearBlock)
void add_near_products(const float* columns, std::size_t n_lights, std::size_t n_padded,
                       float* sums);

}  // namespace haarlight
