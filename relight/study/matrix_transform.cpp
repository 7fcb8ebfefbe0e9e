// SPDX-License-Identifier: Apache-2.0
#include "relight/study/matrix_transform.h"

#include <Eigen/Core>

#include "core/linear_algebra.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

MatrixTransform::MatrixTransform(const Eigen::MatrixXd& patterns)
    : patterns_(patterns.cast<float>()) {
  HAARLIGHT_EXPECTS(patterns.rows() > 0 && patterns.rows() <= patterns.cols(),
                    "no more patterns than lights");
  const Eigen::MatrixXd stored = patterns_.cast<double>();
  const Eigen::MatrixXd gram = stored * stored.transpose();
  analysis_ = Cholesky(gram).solve(stored).cast<float>();
}

void MatrixTransform::analyse(std::span<const float> lights,
                              std::span<float> coefficients) const {
  const Eigen::Index n = static_cast<Eigen::Index>(lights.size()) / patterns_.cols();
  HAARLIGHT_EXPECTS(n * patterns_.cols() == static_cast<Eigen::Index>(lights.size()) &&
                        n * patterns_.rows() == static_cast<Eigen::Index>(coefficients.size()),
                    "whole pixels");
  const Eigen::Map<const Matrix> from(lights.data(), n, patterns_.cols());
  Eigen::Map<Matrix> to(coefficients.data(), n, patterns_.rows());
  to.noalias() = from * analysis_.transpose();
}

void MatrixTransform::synthesise(std::span<const float> coefficients,
                                 std::span<float> lights) const {
  synthesise_first(coefficients, n_coefficients(), lights);
}

void MatrixTransform::synthesise_first(std::span<const float> coefficients, int n_first,
                                       std::span<float> lights) const {
  const Eigen::Index n = static_cast<Eigen::Index>(lights.size()) / patterns_.cols();
  HAARLIGHT_EXPECTS(
      n * patterns_.cols() == static_cast<Eigen::Index>(lights.size()) &&
          n * patterns_.rows() == static_cast<Eigen::Index>(coefficients.size()) &&
          n_first >= 0 && n_first <= n_coefficients(),
      "whole pixels");
  const Eigen::Map<const Matrix> from(coefficients.data(), n, patterns_.rows());
  Eigen::Map<Matrix> to(lights.data(), n, patterns_.cols());
  to.noalias() = from.leftCols(n_first) * patterns_.topRows(n_first);
}

}  // namespace haarlight::relight
