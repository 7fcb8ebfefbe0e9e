// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <utility>
#include <vector>

#include <Eigen/Core>

#include "core/linear_algebra.h"
#include "haarlight/core/error.h"
#include "haarlight/core/rig/patterns.h"

/// @file
/// Patterns as matrices, a row per shot, and their inverse by least squares: what the fast
/// inverses are held to.

namespace haarlight::test {

/// Of lit_lights(): 1 where a light is lit.
[[nodiscard]] inline PatternMatrix matrix_of(const PatternParameters& parameters) {
  const std::vector<std::vector<int>> shots = lit_lights(parameters);
  PatternMatrix patterns =
      PatternMatrix::Zero(static_cast<Eigen::Index>(shots.size()), parameters.n_lights());
  for (std::size_t shot = 0; shot < shots.size(); ++shot) {
    for (const int light : shots[shot]) {
      patterns(static_cast<Eigen::Index>(shot), light) = 1.0;
    }
  }
  return patterns;
}

/// Of s_entry(). @param order  has_s_matrix(order)
[[nodiscard]] inline PatternMatrix s_matrix(int order) {
  PatternMatrix patterns(order, order);
  for (int shot = 0; shot < order; ++shot) {
    for (int light = 0; light < order; ++light) {
      patterns(shot, light) = s_entry(order, shot, light) ? 1.0 : 0.0;
    }
  }
  return patterns;
}

/// @param measured  (shots, pixels)
/// @return  (lights, pixels)
/// @throws ContractViolation  when the patterns cannot separate the lights
[[nodiscard]] inline Eigen::MatrixXd demultiplex(const PatternMatrix& patterns,
                                                 const Eigen::MatrixXd& measured) {
  LeastSquares solved = least_squares(patterns, measured);
  HAARLIGHT_EXPECTS(solved.rank == patterns.cols(), "patterns that tell the lights apart");
  return std::move(solved.solution);
}

}  // namespace haarlight::test
