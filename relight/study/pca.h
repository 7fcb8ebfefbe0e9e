// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "relight/basis/light_basis.h"

/// @file
/// The capture's own basis: the strongest eigenvectors of its covariance over the lights (about
/// zero, not about the mean). The vectors must be stored with the capture: as half floats,
/// which table_bytes() counts.

namespace haarlight::relight {

/// Sum of t t' over rows of values, n_lights x n_lights, accumulated tile by tile.
class LightCovariance {
 public:
  explicit LightCovariance(int n_lights);
  /// @param rows  (n, n_lights); the result does not depend on the number of threads
  void add(std::span<const float> rows);
  /// Symmetric.
  [[nodiscard]] Eigen::MatrixXd matrix() const;

 private:
  int n_lights_;
  Eigen::MatrixXd lower_;
};

struct PrincipalVectors {
  Eigen::MatrixXd vectors;   ///< (n_lights, rank), orthonormal columns, strongest first
  Eigen::VectorXd energies;  ///< (rank), descending
};

/// Up to `rank` eigenvectors; fewer if the rest has no energy. All eigenvectors are computed up
/// to 2048 lights; beyond, subspace iteration [Halko11] from keyed vectors, 8 rounds. Signs:
/// each vector's sum is positive.
[[nodiscard]] PrincipalVectors principal_vectors(const Eigen::MatrixXd& covariance, int rank,
                                                 int most_exact = 2048);

/// The vectors rounded to half floats; coefficients are the least-squares fit of these, so that
/// the rounding costs no accuracy floor.
[[nodiscard]] std::unique_ptr<LightBasis> make_pca_transform(const PrincipalVectors& found);

}  // namespace haarlight::relight
