#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include <Eigen/Core>

/// @file
/// The inner loop of every fit: one small matrix times many pixels. Products are rounded before
/// they are added, in the order of the inputs: the same bits with any width of vector.

namespace haarlight {

/// Pixels that are worked on together: with 150 inputs a block stays in the nearest caches.
inline constexpr std::size_t kFitBlock = 64;
/// Values side by side must be a multiple of this.
inline constexpr std::size_t kFitLanes = 32;

/// n rounded up to what FitMatrix::multiply writes.
[[nodiscard]] constexpr std::size_t fit_rows_padded(std::size_t n) { return (n + 3) / 4 * 4; }

/// A matrix laid out for the loop: four rows side by side, column by column.
class FitMatrix {
 public:
  FitMatrix() = default;
  explicit FitMatrix(const Eigen::MatrixXd& matrix);
  /// All zero.
  FitMatrix(std::size_t n_out, std::size_t n_in);
  [[nodiscard]] std::size_t n_out() const noexcept { return n_out_; }
  [[nodiscard]] std::size_t n_in() const noexcept { return n_in_; }

  /// Becomes (1 - t) a + t b, of the same shape.
  void blend(const FitMatrix& a, const FitMatrix& b, float t);

  /// out[o][x] = sum over i of matrix(o, i) * in[i][x] for n values x.
  /// @param in   n_in rows, in_stride apart
  /// @param n    a multiple of kFitLanes
  /// @param out  fit_rows_padded(n_out) rows, out_stride apart
  void multiply(const float* in, std::size_t in_stride, std::size_t n, float* out,
                std::size_t out_stride) const;

 private:
  std::size_t n_out_ = 0;
  std::size_t n_in_ = 0;
  std::vector<float> fours_;  ///< (ceil(n_out / 4), n_in, 4)
};

/// 16-bit codes to 0..1.
void widen_codes(const std::uint16_t* codes, std::size_t n, float* values);
/// The same, pixels of three channels side by side to three rows.
void split_codes(const std::uint16_t* codes, std::size_t n_pixels, float* r, float* g,
                 float* b);

}  // namespace haarlight
