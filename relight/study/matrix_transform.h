// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include <Eigen/Core>

#include "relight/basis/light_basis.h"

/// @file
/// A transform given by its light patterns, one per row.

namespace haarlight::relight {

class MatrixTransform : public LightBasis {
 public:
  using Matrix = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

  /// @param patterns  (n_coefficients, n_lights), nearly orthonormal rows; analysis is the
  ///                  least-squares fit of them
  explicit MatrixTransform(const Eigen::MatrixXd& patterns);
  [[nodiscard]] int n_lights() const override { return static_cast<int>(patterns_.cols()); }
  [[nodiscard]] int n_coefficients() const override {
    return static_cast<int>(patterns_.rows());
  }
  [[nodiscard]] bool is_complete() const override { return n_lights() == n_coefficients(); }
  void analyse(std::span<const float> lights, std::span<float> coefficients) const override;
  void synthesise(std::span<const float> coefficients, std::span<float> lights) const override;
  void synthesise_first(std::span<const float> coefficients, int n,
                        std::span<float> lights) const override;

 private:
  Matrix analysis_;
  Matrix patterns_;
};

}  // namespace haarlight::relight
