// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <span>
#include <vector>

/// @file
/// Least squares on a pixel grid whose neighbours are joined by weighted edges:
///
///     minimise  sum over edges (a, b) of  w (z_b - z_a - s)^2
///
/// the normal equations L z = f of which are a Laplacian. Any mask and any weights >= 0 (0: not
/// joined), any number of connected parts. Conjugate gradients in double, preconditioned by one
/// V-cycle of multigrid in float: blocks of 2 x 2 pixels with one height each, edges between
/// blocks summed and halved (the sum alone is twice too stiff for a smooth surface), one
/// red-black Gauss-Seidel sweep before and one after. O(pixels) memory (about 60 bytes each)
/// and time.

namespace haarlight::relight {

struct GridSolve {
  int iterations = 0;
  /// Preconditioned residual relative to the right-hand side: the error's energy.
  double residual = 0.0;
  bool is_converged = false;
};

class GridLaplacian {
 public:
  /// @param right  (height, width): weight of (y, x) - (y, x + 1); the last column's is ignored
  /// @param down   (height, width): weight of (y, x) - (y + 1, x); the last row's is ignored
  GridLaplacian(int height, int width, std::vector<float> right, std::vector<float> down);

  /// Edge sums: f_a -= w s, f_b += w s. `steps_right`, `steps_down`: (height, width).
  [[nodiscard]] std::vector<double> divergence(std::span<const float> steps_right,
                                               std::span<const float> steps_down) const;

  /// Improves `z` (its start) until the residual is below `tolerance`. Each part's constant is
  /// left to rounding: the caller fixes the gauge. Pixels without edges keep z.
  [[nodiscard]] GridSolve solve(std::span<const double> f, std::span<double> z,
                                double tolerance, int max_iterations) const;

 private:
  struct Level {
    int height = 0;
    int width = 0;
    std::vector<float> right;
    std::vector<float> down;
    std::vector<float> inverse_diagonal;  ///< 0 for a pixel without edges
  };
  /// Working memory for one cycle.
  struct Room {
    std::vector<std::vector<float>> f;
    std::vector<std::vector<float>> z;
  };
  static void finish(Level& level);
  static Level coarsen(const Level& fine);
  static void sweep(const Level& level, std::span<const float> f, std::span<float> z,
                    int colour);
  void cycle(std::size_t i_level, Room& room) const;
  void apply(std::span<const double> z, std::span<double> out) const;

  std::vector<Level> levels_;
};

}  // namespace haarlight::relight
