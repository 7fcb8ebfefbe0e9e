// SPDX-License-Identifier: Apache-2.0
#include "relight/study/pca.h"

#include <algorithm>

#include <Eigen/Core>

#include "core/linear_algebra.h"
#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "relight/basis/half_float.h"
#include "relight/study/matrix_transform.h"

namespace haarlight::relight {

namespace {

using Eigen::Index;
using Eigen::MatrixXd;

constexpr std::size_t kPanel = 64;  // lights per piece of work
constexpr Index kRows = 512;  // pixels summed in float before they are added to the double sum
constexpr int kRounds = 8;    // of subspace iteration
constexpr int kOversampling = 16;    // [Halko11] recommends 5 to 10
constexpr double kNoEnergy = 1e-13;  // of the strongest: the floats' own rounding

PrincipalVectors iterate_subspace(const MatrixXd& covariance, Index rank) {
  const Index n = covariance.rows();
  const Index k = std::min<Index>(n, rank + kOversampling);
  MatrixXd z(n, k);
  for (Index j = 0; j < k; ++j) {
    for (Index i = 0; i < n; ++i) {
      z(i, j) = uniform_unit(hash_key(0x706361, static_cast<std::uint64_t>(i),
                                      static_cast<std::uint64_t>(j))) -
                0.5;
    }
  }
  for (int i = 0; i < kRounds; ++i) {
    z = orthonormal_columns(covariance * z);
  }
  const MatrixXd small = z.transpose() * (covariance * z);
  const SymmetricEigen eigen = symmetric_eigen(0.5 * (small + small.transpose()));
  return {z * eigen.vectors.rowwise().reverse(), eigen.values.reverse()};
}

class PcaTransform final : public MatrixTransform {
 public:
  using MatrixTransform::MatrixTransform;
  [[nodiscard]] bool is_ranked() const override { return true; }
  [[nodiscard]] std::size_t table_bytes(int n) const override {
    return static_cast<std::size_t>(n) * static_cast<std::size_t>(n_lights()) * 2;
  }
};

}  // namespace

LightCovariance::LightCovariance(int n_lights)
    : n_lights_(n_lights), lower_(MatrixXd::Zero(n_lights, n_lights)) {}

void LightCovariance::add(std::span<const float> rows) {
  const Index n = n_lights_;
  HAARLIGHT_EXPECTS(rows.size() % static_cast<std::size_t>(n) == 0, "whole pixels");
  const Index n_rows = static_cast<Index>(rows.size()) / n;
  const Eigen::Map<const MatrixTransform::Matrix> all(rows.data(), n_rows, n);
  parallel_for(static_cast<std::size_t>(n), kPanel, [&](std::size_t begin, std::size_t end) {
    const auto first = static_cast<Index>(begin);
    const auto cols = static_cast<Index>(end - begin);
    for (Index row = 0; row < n_rows; row += kRows) {
      const Index some = std::min(kRows, n_rows - row);
      const MatrixXd part = all.block(row, first, some, n - first).cast<double>();
      lower_.block(first, first, n - first, cols).noalias() +=
          part.transpose() * part.leftCols(cols);
    }
  });
}

MatrixXd LightCovariance::matrix() const { return lower_.selfadjointView<Eigen::Lower>(); }

PrincipalVectors principal_vectors(const MatrixXd& covariance, int rank, int most_exact) {
  HAARLIGHT_EXPECTS(covariance.rows() == covariance.cols() && rank > 0, "a covariance");
  const Index wanted = std::min<Index>(rank, covariance.rows());
  PrincipalVectors found;
  if (covariance.rows() <= most_exact) {
    const SymmetricEigen eigen = symmetric_eigen(covariance);
    found = {eigen.vectors.rowwise().reverse(), eigen.values.reverse()};
  } else {
    found = iterate_subspace(covariance, wanted);
  }
  Index kept = 1;
  while (kept < wanted && found.energies[kept] > kNoEnergy * found.energies[0]) {
    ++kept;
  }
  found.vectors = MatrixXd(found.vectors.leftCols(kept));
  found.energies = Eigen::VectorXd(found.energies.head(kept));
  for (Index i = 0; i < kept; ++i) {
    if (found.vectors.col(i).sum() < 0.0) {
      found.vectors.col(i) = -found.vectors.col(i);
    }
  }
  return found;
}

std::unique_ptr<LightBasis> make_pca_transform(const PrincipalVectors& found) {
  MatrixXd patterns = found.vectors.transpose();
  for (Index j = 0; j < patterns.cols(); ++j) {
    for (Index i = 0; i < patterns.rows(); ++i) {
      const auto value = static_cast<float>(patterns(i, j));
      patterns(i, j) = double{half_to_float(float_to_half(value))};
    }
  }
  return std::make_unique<PcaTransform>(patterns);
}

}  // namespace haarlight::relight
