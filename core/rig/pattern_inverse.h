// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/rig/patterns.h"

/// @file
/// Demultiplexing: from measured shots to single lights, for every family of patterns, and what
/// that does to noise. Everything here is linear in the measured values, pixel by pixel; sums
/// run in double in a fixed order. Methods, errors and cost: docs/numerics/patterns.md.

namespace haarlight {

/// In place x <- H x, H the Walsh-Hadamard matrix of order n in Sylvester's order; log2(n)
/// passes of additions.
/// @param x  (n, width), n a power of two; each column is transformed
void walsh_hadamard(std::span<double> x, std::size_t n, std::size_t width);

/// In place T = S^-1 M = 2/(order + 1) (2 S^T - J) M [Sloane79]. Sylvester orders cost
/// log2(order + 1) additions per value, others order / 2.
/// @param x  (order, width)
void s_matrix_inverse(int order, std::span<double> x, std::size_t width);

/// In place: coefficient array of an n x n grid to the grid's values and back, orthonormal,
/// the layout of haarlight/relight/basis/haar.h. @param x  (n * n, width)
void wavelets_to_lights(int n, std::span<double> x, std::size_t width);
void lights_to_wavelets(int n, std::span<double> x, std::size_t width);

/// One light of a shot and its drive level in (0, 1].
struct LightDriveLevel {
  int light = 0;
  double drive = 1.0;
};

/// Undoes one set of shots. What it returns is T' = power * T, T the light transport matrix:
/// the caller divides by the lights' relative powers. Thread-safe after construction.
class PatternInverse {
 public:
  /// @param shots  of a family with lit_lights(): those lights in that order, each family
  ///               (except list, target) with one drive level throughout; target: at most 8
  ///               shots; list: any patterns that separate the lights
  /// @throws ContractViolation  shots that do not match the parameters
  /// @throws Error              list: patterns that cannot separate the lights
  PatternInverse(PatternParameters parameters, std::vector<std::vector<LightDriveLevel>> shots,
                 int n_lights);

  [[nodiscard]] int n_lights() const noexcept { return n_lights_; }
  [[nodiscard]] int n_shots() const noexcept { return static_cast<int>(shots_.size()); }
  /// True when the shots do not determine the lights, so that a clean plate must say how the
  /// light of a shot is distributed: bins of more than one light, target, haar with some
  /// wavelets.
  [[nodiscard]] bool needs_plate() const noexcept { return needs_plate_; }

  /// @param measured  (n_shots, width): linear signal per unit of exposure
  /// @param plate     (n_lights, width), not negative: the clean plate times relative power; a
  ///                  pixel of zeros is distributed evenly. Empty: evenly everywhere (haar:
  ///                  missing wavelets are 0)
  /// @param lights    (n_lights, width), overwritten
  void apply(std::span<const double> measured, std::span<const double> plate, std::size_t width,
             std::span<double> lights) const;

  /// How independent noise of the shots propagates: with apply() written T' = A M + ..., the
  /// variances sum_j A_kj^2 v_j, in closed form (a sum for the S-matrix, only additions for
  /// wavelets). @param shots  (n_shots, width), not negative
  /// @param plate, lights   as in apply()
  void apply_variance(std::span<const double> shots, std::span<const double> plate,
                      std::size_t width, std::span<double> lights) const;

  /// The weights a with sum_k w_k T'_k = sum_j a_j M_j at one pixel: how the shots' noise
  /// enters a picture that is relit with w.
  /// @param w, plate  (n_lights); plate may be empty
  /// @param a         (n_shots), overwritten
  void shot_weights(std::span<const double> w, std::span<const double> plate,
                    std::span<double> a) const;

  /// The shots that these light values give: M = P T'.
  /// @param lights  (n_lights, width)   @param measured  (n_shots, width), overwritten
  void shoot(std::span<const double> lights, std::size_t width,
             std::span<double> measured) const;

  [[nodiscard]] const PatternParameters& parameters() const noexcept { return parameters_; }
  [[nodiscard]] const std::vector<std::vector<LightDriveLevel>>& shots() const noexcept {
    return shots_;
  }

 private:
  void apply_s_matrix(std::span<const double> measured, std::size_t width,
                      std::span<double> lights) const;
  void apply_haar(std::span<const double> measured, std::span<const double> plate,
                  std::size_t width, std::span<double> lights) const;
  void apply_bins(std::span<const double> measured, std::span<const double> plate,
                  std::size_t width, std::span<double> lights) const;
  void apply_target(std::span<const double> measured, std::span<const double> plate,
                    std::size_t width, std::span<double> lights) const;
  void s_matrix_variance(std::span<const double> shots, std::size_t width,
                         std::span<double> lights) const;
  void haar_variance(std::span<const double> shots, std::span<const double> plate,
                     std::size_t width, std::span<double> lights) const;
  void target_variance(std::span<const double> shots, std::span<const double> plate,
                       std::size_t width, std::span<double> lights) const;
  void shared_weights(std::span<const double> w, std::span<const double> plate,
                      std::span<double> a) const;
  void haar_weights(std::span<const double> w, std::span<const double> plate,
                    std::span<double> a) const;
  /// (P diag(b) P^T)^-1 at one pixel, for shots that share lights.
  [[nodiscard]] Eigen::MatrixXd gram_inverse(std::span<const double> b) const;

  PatternParameters parameters_;
  std::vector<std::vector<LightDriveLevel>> shots_;
  int n_lights_ = 0;
  double drive_ = 1.0;
  bool needs_plate_ = false;
  Eigen::MatrixXd inverse_;  ///< list: (lights, shots)
};

}  // namespace haarlight
