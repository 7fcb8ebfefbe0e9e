// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include <Eigen/Core>

/// @file
/// Form factors of elements of a scene, and the radiosity equation [Goral84] solved with them:
/// B_i = E_i + rho_i sum_j F_ij B_j, where F_ij is the fraction of what leaves i that arrives at j, as
/// reciprocity A_i F_ij = A_j F_ji makes of what arrives from j.
///
/// What is kept is K_ij = F_ij sqrt(A_i/A_j): symmetric by reciprocity, without unit, and sparse.

namespace haarlight::render {

/// A symmetric matrix K without diagonal, row by row. @tparam Real  float or double
template <class Real>
struct Exchange {
  Eigen::VectorXd root_area;           ///< (n,) sqrt(A_i)
  std::vector<std::size_t> row_begin;  ///< (n + 1,)
  std::vector<std::uint32_t> columns;  ///< ascending in each row
  std::vector<Real> values;

  [[nodiscard]] std::size_t size() const noexcept { return row_begin.size() - 1; }
  /// K x
  [[nodiscard]] Eigen::VectorXd times(const Eigen::VectorXd& x) const;
  [[nodiscard]] double form_factor(std::size_t from, std::size_t to) const;
  /// sum_j F_ij: how much of what leaves an element arrives at others.
  [[nodiscard]] Eigen::VectorXd row_sums() const;
};

/// Hits of one element's rays on another.
struct RayCount {
  std::uint32_t element = 0;
  std::uint32_t n = 0;
};

/// Form factors from rays that leave each element evenly over its area and by the cosine law, n_i of
/// them. Those of both ends count together, A_i F_ij = (n_ij + n_ji)/(n_i/A_i + n_j/A_j): the balance
/// heuristic [Veach95] for two ways to draw the same line. Then K is multiplied by a factor for each row and
/// column [Sinkhorn67] so that rows sum to the fraction of an element's rays that met others, 1 in a
/// closed room; none is left above 1.
/// @param counts  by element, ascending in their elements, none of itself; emptied on the way
/// @param n_rays  of each element; none have met nothing, and are met by nothing
[[nodiscard]] Exchange<float> exchange_of(std::vector<std::vector<RayCount>>& counts,
                                          std::span<const std::uint32_t> n_rays,
                                          const Eigen::VectorXd& root_area);

/// Memory that exchange_of takes at most.
[[nodiscard]] std::uint64_t exchange_bytes(std::size_t n_elements, std::uint32_t n_rays);

struct RadiositySolution {
  Eigen::VectorXd radiosity;    ///< B
  Eigen::VectorXd irradiation;  ///< sum_j F_ij B_j: what arrives
  int iterations = 0;
  double residual = 0.0;  ///< relative
};

/// By conjugate gradients: with B = E + rho X the equation of sqrt(A/rho) times the reflected part
/// is symmetric and positive definite.
/// @param emitted      (n,) E_i, not negative
/// @param reflectance  (n,) in 0..1
/// @throws Error  the surfaces absorb next to nothing, and none of the light leaves the scene
/// The same for any number of threads.
template <class Real>
[[nodiscard]] RadiositySolution solve_radiosity(const Exchange<Real>& exchange,
                                                const Eigen::VectorXd& emitted,
                                                const Eigen::VectorXd& reflectance);

extern template struct Exchange<float>;
extern template struct Exchange<double>;

}  // namespace haarlight::render
