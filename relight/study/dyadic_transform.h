// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <span>
#include <vector>

/// @file 2-D wavelets by lifting [Sweldens98] on an array of any size, in place: level j works
/// on the points whose row and column are multiples of 2^j, and leaves its details on the odd
/// multiples. Both directions per level (nonstandard), down to a single point.
///
/// CDF 5/3 [LeGall88]: d = x1 - (x0 + x2)/2, s = x0 + (d- + d+)/4, mirrored at the borders; two
/// vanishing moments on both sides. Haar: d = (x0 - x1)/sqrt 2, s = (x0 + x1)/sqrt 2; a last
/// point without a partner is unchanged.

namespace haarlight::relight {

enum class Wavelet { haar, cdf53 };

/// Const calls are thread-safe.
class DyadicTransform {
 public:
  /// @throws ContractViolation  no rows or columns
  DyadicTransform(Wavelet wavelet, int rows, int cols);

  /// In place on (rows, cols, width): numbers [first, first + n) of every point, each
  /// independently. Results are multiplied by norms(). Calls on disjoint numbers may run
  /// concurrently.
  void forward(std::span<float> x, std::size_t width, std::size_t first, std::size_t n) const;
  void inverse(std::span<float> x, std::size_t width, std::size_t first, std::size_t n) const;

  /// (rows, cols): L2 norm of the array represented by a coefficient of 1 at this index, exact
  /// at the borders too. 1 for Haar.
  [[nodiscard]] std::span<const float> norms() const noexcept { return norms_; }
  /// Indices from coarse to fine, within each level by kind and then by row: the storage order.
  [[nodiscard]] std::span<const int> order() const noexcept { return order_; }

 private:
  struct Part;
  void lift(const Part& part, int level, bool is_forward) const;
  void scale(const Part& part, bool is_forward) const;

  Wavelet wavelet_;
  int rows_;
  int cols_;
  int n_levels_ = 0;
  std::vector<float> norms_;
  std::vector<int> order_;
};

}  // namespace haarlight::relight
