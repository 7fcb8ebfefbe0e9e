// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>

#include <Eigen/Core>

/// @file
/// Factorisations of dense matrices of any size, in double: Eigen's, compiled once, here. Each
/// costs 2 to 6 s of compilation wherever it is instantiated; a fixed size of 3 does not.
/// Shapes are the caller's promise (Eigen asserts them in debug builds); nothing here throws
/// except when out of memory. Non-finite input gives non-finite results.

namespace haarlight {

/// L L^T of a symmetric positive definite matrix, only the lower triangle is read.
class Cholesky {
 public:
  Cholesky();  ///< of an empty matrix: is_positive_definite() is false
  explicit Cholesky(const Eigen::MatrixXd& a);
  Cholesky(const Cholesky& other);
  Cholesky(Cholesky&& other) noexcept;
  Cholesky& operator=(const Cholesky& other);
  Cholesky& operator=(Cholesky&& other) noexcept;
  ~Cholesky();

  [[nodiscard]] bool is_positive_definite() const;
  /// a^-1 b. Call this and the following functions only if is_positive_definite().
  [[nodiscard]] Eigen::MatrixXd solve(const Eigen::MatrixXd& b) const;
  [[nodiscard]] Eigen::VectorXd solve(const Eigen::VectorXd& b) const;
  [[nodiscard]] Eigen::VectorXd solve_lower(const Eigen::VectorXd& b) const;  ///< L^-1 b
  /// The lower right corner of L, (n, n), zero above its diagonal.
  [[nodiscard]] Eigen::MatrixXd corner(Eigen::Index n) const;

 private:
  struct Factor;
  std::unique_ptr<Factor> factor_;
};

/// a^-1 b by L D L^T, for a symmetric semidefinite; only the lower triangle is read. Where a is
/// singular, its smallest terms count as 0.
[[nodiscard]] Eigen::MatrixXd solve_symmetric(const Eigen::MatrixXd& a,
                                              const Eigen::MatrixXd& b);
[[nodiscard]] Eigen::VectorXd solve_symmetric(const Eigen::MatrixXd& a,
                                              const Eigen::VectorXd& b);

/// The inverse of a square matrix, with row pivoting.
[[nodiscard]] Eigen::MatrixXd inverse_by_lu(const Eigen::MatrixXd& a);

/// a V = V diag(values) of a symmetric matrix; values ascending, vectors orthonormal columns.
struct SymmetricEigen {
  Eigen::VectorXd values;
  Eigen::MatrixXd vectors;
};
[[nodiscard]] SymmetricEigen symmetric_eigen(
    const Eigen::MatrixXd& a);  ///< reads the lower triangle

/// An orthonormal basis of the columns' span, (rows, cols), by Householder's QR.
/// @pre  rows >= cols
[[nodiscard]] Eigen::MatrixXd orthonormal_columns(const Eigen::MatrixXd& a);

/// argmin |a x - b| by QR with column pivoting, and the numerical rank of a: where that is less
/// than a's columns, the solution is meaningless.
struct LeastSquares {
  Eigen::MatrixXd solution;  ///< (a.cols, b.cols)
  Eigen::Index rank = 0;
};
[[nodiscard]] LeastSquares least_squares(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b);
/// Columns whose pivot is at most `threshold` of the largest do not count.
[[nodiscard]] Eigen::Index column_rank(const Eigen::MatrixXd& a, double threshold);

/// The pseudo-inverse by a complete orthogonal decomposition; pivots of at most `threshold` of
/// the largest count as 0.
[[nodiscard]] Eigen::MatrixXd pseudo_inverse(const Eigen::MatrixXd& a, double threshold);

/// Singular values, descending, min(rows, cols) of them, and the right singular vectors, (cols,
/// cols).
struct RightSingular {
  Eigen::VectorXd values;
  Eigen::MatrixXd vectors;
};
[[nodiscard]] RightSingular right_singular(const Eigen::MatrixXd& a);

}  // namespace haarlight
