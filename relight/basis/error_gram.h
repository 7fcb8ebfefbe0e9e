// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "relight/basis/relight_kernels.h"

/// @file
/// How the error pictures of the coefficients correlate: their products <E_i, E_j> over the
/// pixels, and from them a bound on ||sum l_i E_i|| that a file can store. Products are sums of
/// whole numbers: the same for any order and any number of threads and processes. Method, cost
/// and figures: docs/numerics/relight.md, "The coding error's bound".

namespace haarlight::relight {

/// Products are formed within blocks of this many neighbours in coefficient order; between
/// blocks the triangle inequality is used.
inline constexpr int kGramBlock = 1024;
/// An error is rounded to an integer of at most this magnitude: 2^20 squares fit 31 bits.
inline constexpr int kGramLargest = 1400;

[[nodiscard]] int n_gram_blocks(int n_lights);
/// Products of one channel: the lower triangle of each block, row by row.
[[nodiscard]] std::size_t gram_size(int n_lights);

/// Whole numbers of one cache line: no load of a vector register crosses two.
inline constexpr std::size_t kNumberLine = 32;
struct alignas(64) NumberLine {
  std::array<std::int16_t, kNumberLine> numbers{};
};

/// The errors of one tile and channel as whole numbers, coefficient by coefficient.
class TileErrors {
 public:
  /// @param n_pixels  at most 1024
  TileErrors(std::span<const int> indices, std::size_t n_pixels);

  /// The errors of the next pixel, (n_lights) in light-domain index order.
  /// @param inverse_scale  1 / the size of a whole step
  void append(std::span<const float> errors, double inverse_scale);
  void append(std::span<const double> errors, double inverse_scale);

  /// Every pixel was appended: sum over the pixels of n_i n_j, (gram_size(n_lights)).
  [[nodiscard]] std::vector<std::int32_t> products(KernelCode code = best_kernel_code());
  /// The largest rounding error of any appended error, in steps.
  [[nodiscard]] double largest_rest() const noexcept { return largest_rest_; }

 private:
  template <class Real>
  void append_row(std::span<const Real> errors, Real inverse_scale);
  void transpose();

  std::span<const int> indices_;
  std::size_t n_pixels_;
  std::size_t stride_;               ///< pixels per row, padded with zeros
  std::vector<NumberLine> rows_;     ///< (n_lights, stride), in coefficient order
  std::vector<std::int16_t> batch_;  ///< (pixels of the batch, n_lights), by index
  std::size_t n_batch_ = 0;
  std::size_t n_done_ = 0;
  double largest_rest_ = 0.0;
};

/// Products of stored coefficients, pixel by pixel: few are nonzero.
class SparseProducts {
 public:
  explicit SparseProducts(int n_lights);
  /// @param indices  ascending, in the order of coefficients
  void add(std::span<const int> indices, std::span<const double> values);
  /// (gram_size(n_lights))
  [[nodiscard]] std::span<const double> products() const noexcept { return products_; }

 private:
  std::vector<double> products_;
};

/// ||sum l_i P_i||^2 <= sum_j (v_j . (p o l))^2 + fraction ||p o l||^2 for all l, p_i >=
/// ||P_i||: the products of P_i / p_i are v' v plus a rest whose largest eigenvalue is below
/// `fraction`.
struct ProductBound {
  float fraction = 0.0F;       ///< rounded up; proven by a Cholesky factor
  std::vector<float> vectors;  ///< (n_vectors, n), as rounded: the proof is for these numbers
};

/// @param products   (n (n + 1) / 2) lower triangle of <P_i, P_j>, each within 2^-23 p_i p_j
/// @param norms      (n): p_i; where 0 the products are 0
/// @param n_vectors  at most n
/// Deterministic; O(n^3 / 3 + n^2 n_vectors).
[[nodiscard]] ProductBound fit_product_bound(std::span<const double> products,
                                             std::span<const float> norms, int n_vectors);

}  // namespace haarlight::relight
