// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "relight/study/basis_study.h"

/// @file
/// Sums of squares over pixels, separately per region: of errors over all lights, and of errors
/// of pictures. In a fixed order: independent of the number of threads.

namespace haarlight::relight {

class ErrorTally {
 public:
  explicit ErrorTally(std::size_t n_pictures = 0) : pictures_(n_pictures) {}

  /// @param stack     squares over the lights of one pixel
  /// @param pictures  the pixel's value in each picture; squared here
  void add(Region region, double stack, std::span<const double> pictures, double factor = 1.0);
  [[nodiscard]] const ByRegion& stack() const noexcept { return stack_; }
  [[nodiscard]] const ByRegion& picture(std::size_t i) const { return pictures_[i]; }

 private:
  ByRegion stack_{};
  std::vector<ByRegion> pictures_;
};

/// Squares over the lights and values in pictures of many pixels.
struct RowSums {
  std::vector<double> energy;  ///< (n)
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>
      pictures;  ///< (n, lightings)
};
/// @param rows     (n, n_lights)
/// @param weights  (n_lights, lightings)
[[nodiscard]] RowSums sum_rows(std::span<const float> rows, const Eigen::MatrixXd& weights);

/// sqrt(error / truth) in each region; NaN where the truth is 0.
[[nodiscard]] ByRegion relative_errors(const ByRegion& error, const ByRegion& truth);

}  // namespace haarlight::relight
