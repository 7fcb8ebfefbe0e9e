// SPDX-License-Identifier: Apache-2.0
#include "core/linear_algebra.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/QR>
#include <Eigen/SVD>

namespace haarlight {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

struct Cholesky::Factor {
  Eigen::LLT<MatrixXd> llt;
};

Cholesky::Cholesky() = default;
Cholesky::Cholesky(const MatrixXd& a) : factor_(std::make_unique<Factor>(Factor{a.llt()})) {}
Cholesky::Cholesky(const Cholesky& other)
    : factor_(other.factor_ ? std::make_unique<Factor>(*other.factor_) : nullptr) {}
Cholesky::Cholesky(Cholesky&& other) noexcept = default;
Cholesky& Cholesky::operator=(const Cholesky& other) { return *this = Cholesky(other); }
Cholesky& Cholesky::operator=(Cholesky&& other) noexcept = default;
Cholesky::~Cholesky() = default;

bool Cholesky::is_positive_definite() const {
  return factor_ && factor_->llt.info() == Eigen::Success;
}

MatrixXd Cholesky::solve(const MatrixXd& b) const { return factor_->llt.solve(b); }

VectorXd Cholesky::solve(const VectorXd& b) const { return factor_->llt.solve(b); }

VectorXd Cholesky::solve_lower(const VectorXd& b) const {
  return factor_->llt.matrixL().solve(b);
}

MatrixXd Cholesky::corner(Index n) const {
  return factor_->llt.matrixLLT().bottomRightCorner(n, n).triangularView<Eigen::Lower>();
}

MatrixXd solve_symmetric(const MatrixXd& a, const MatrixXd& b) { return a.ldlt().solve(b); }

VectorXd solve_symmetric(const MatrixXd& a, const VectorXd& b) { return a.ldlt().solve(b); }

MatrixXd inverse_by_lu(const MatrixXd& a) { return a.partialPivLu().inverse(); }

SymmetricEigen symmetric_eigen(const MatrixXd& a) {
  const Eigen::SelfAdjointEigenSolver<MatrixXd> solver(a);
  return {solver.eigenvalues(), solver.eigenvectors()};
}

MatrixXd orthonormal_columns(const MatrixXd& a) {
  const Eigen::HouseholderQR<MatrixXd> qr(a);
  return qr.householderQ() * MatrixXd::Identity(a.rows(), a.cols());
}

LeastSquares least_squares(const MatrixXd& a, const MatrixXd& b) {
  const Eigen::ColPivHouseholderQR<MatrixXd> qr(a);
  return {qr.solve(b), qr.rank()};
}

Index column_rank(const MatrixXd& a, double threshold) {
  Eigen::ColPivHouseholderQR<MatrixXd> qr(a);
  qr.setThreshold(threshold);
  return qr.rank();
}

MatrixXd pseudo_inverse(const MatrixXd& a, double threshold) {
  Eigen::CompleteOrthogonalDecomposition<MatrixXd> solver;
  solver.setThreshold(threshold);
  solver.compute(a);
  return solver.pseudoInverse();
}

RightSingular right_singular(const MatrixXd& a) {
  const Eigen::JacobiSVD<MatrixXd> svd(a, Eigen::ComputeFullV);
  return {svd.singularValues(), svd.matrixV()};
}

}  // namespace haarlight
