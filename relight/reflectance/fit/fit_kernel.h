// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include <Eigen/Core>

/// @file
/// The inner loop of every fit: one small matrix times many pixels. Sums are float, in the
/// order of the inputs, a product added unrounded where the machine can (lanes.inc): the same
/// bits for every vector width with such an instruction.

namespace haarlight::relight {

/// Pixels processed together.
inline constexpr std::size_t kFitBlock = 64;
/// The number of adjacent values must be a multiple of this.
inline constexpr std::size_t kFitLanes = 32;

/// n rounded up to the number of rows that FitMatrix::multiply writes.
[[nodiscard]] constexpr std::size_t fit_rows_padded(std::size_t n) { return (n + 2) / 3 * 3; }

/// A matrix laid out for the loop: three rows side by side, column by column.
class FitMatrix {
 public:
  explicit FitMatrix(const Eigen::MatrixXd& matrix);
  [[nodiscard]] std::size_t n_out() const noexcept { return n_out_; }
  [[nodiscard]] std::size_t n_in() const noexcept { return n_in_; }

  /// out[o][x] = sum over i of matrix(o, i) * in[i][x] for n values x.
  /// @param in   n_in rows, in_stride apart
  /// @param n    a multiple of kFitLanes
  /// @param out  fit_rows_padded(n_out) rows, out_stride apart
  void multiply(const float* in, std::size_t in_stride, std::size_t n, float* out,
                std::size_t out_stride) const;
  /// The same for raw 16-bit codes.
  void multiply(const std::uint16_t* in, std::size_t in_stride, std::size_t n, float* out,
                std::size_t out_stride) const;

 private:
  std::size_t n_out_ = 0;
  std::size_t n_in_ = 0;
  std::vector<float> threes_;  ///< (ceil(n_out / 3), n_in, 3)
};

/// Interleaved 16-bit codes of three channels to three rows of 0..1.
void split_codes(const std::uint16_t* codes, std::size_t n_pixels, float* r, float* g,
                 float* b);

}  // namespace haarlight::relight
