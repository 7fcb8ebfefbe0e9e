// SPDX-License-Identifier: Apache-2.0
#include "core/linear_algebra.h"

#include <cmath>
#include <utility>

#include <Eigen/Core>
#include <gtest/gtest.h>

namespace haarlight {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

// 1/(i + j + 1): its inverse is whole numbers.
MatrixXd hilbert(Index rows, Index cols) {
  return MatrixXd::NullaryExpr(
      rows, cols, [](Index i, Index j) { return 1.0 / static_cast<double>(i + j + 1); });
}

// Of rank 2: the third column is the sum of the others.
MatrixXd of_rank_two() {
  MatrixXd a(4, 3);
  a << 1, 0, 1, 2, 1, 3, 0, 3, 3, -1, 2, 1;
  return a;
}

TEST(LinearAlgebra, CholeskySolvesAndKnowsWhatIsNotPositive) {
  const MatrixXd a = hilbert(3, 3);
  MatrixXd exact(3, 3);
  exact << 9, -36, 30, -36, 192, -180, 30, -180, 180;
  const Cholesky factor(a);
  ASSERT_TRUE(factor.is_positive_definite());
  // The condition is 524: 524 * 2^-53 of the largest, a few times.
  EXPECT_LT((factor.solve(MatrixXd(MatrixXd::Identity(3, 3))) - exact).cwiseAbs().maxCoeff(),
            1e-10);
  EXPECT_LT((factor.solve(VectorXd(VectorXd::Unit(3, 1))) - exact.col(1)).norm(), 1e-10);
  // L (L^-1 b) = b, with L's corner of the whole size.
  const VectorXd b = VectorXd::LinSpaced(3, 1.0, 2.0);
  EXPECT_LT((factor.corner(3) * factor.solve_lower(b) - b).norm(), 1e-14);
  EXPECT_EQ(factor.corner(2)(0, 1), 0.0);
  EXPECT_EQ(factor.corner(2), factor.corner(3).bottomRightCorner(2, 2));

  MatrixXd indefinite = a;
  indefinite(2, 2) = 0.0;
  EXPECT_FALSE(Cholesky(indefinite).is_positive_definite());
  EXPECT_FALSE(Cholesky().is_positive_definite());
}

TEST(LinearAlgebra, CholeskyIsCopiedAndMoved) {
  Cholesky first(hilbert(2, 2));
  const Cholesky copy = first;
  Cholesky moved = std::move(first);
  EXPECT_EQ(copy.corner(2), moved.corner(2));
  moved = Cholesky(MatrixXd(4.0 * MatrixXd::Identity(2, 2)));
  EXPECT_EQ(moved.corner(1)(0, 0), 2.0);
  EXPECT_EQ(copy.corner(2)(0, 0), 1.0);
  first = copy;
  EXPECT_TRUE(first.is_positive_definite());
}

TEST(LinearAlgebra, SymmetricSystemsReadTheLowerHalf) {
  MatrixXd a = hilbert(3, 3);
  a.triangularView<Eigen::StrictlyUpper>().setConstant(7.0);
  const VectorXd x = VectorXd::LinSpaced(3, 1.0, 3.0);
  const VectorXd b = hilbert(3, 3) * x;
  EXPECT_LT((solve_symmetric(a, b) - x).norm(), 1e-12);
  EXPECT_LT((solve_symmetric(a, MatrixXd(b)) - x).norm(), 1e-12);
  const SymmetricEigen eigen = symmetric_eigen(a);
  EXPECT_LT(eigen.values[0], eigen.values[1]);
  EXPECT_LT(eigen.values[1], eigen.values[2]);
  EXPECT_LT(
      (eigen.vectors * eigen.values.asDiagonal() * eigen.vectors.transpose() - hilbert(3, 3))
          .norm(),
      1e-14);
}

TEST(LinearAlgebra, LeastSquaresSaysTheRank) {
  const MatrixXd tall = hilbert(5, 3);
  const VectorXd x = VectorXd::LinSpaced(3, -1.0, 1.0);
  const LeastSquares whole = least_squares(tall, tall * x);
  EXPECT_EQ(whole.rank, 3);
  EXPECT_LT((whole.solution - x).norm(), 1e-11);  // condition 700, with some to spare

  const MatrixXd a = of_rank_two();
  EXPECT_EQ(least_squares(a, VectorXd::LinSpaced(4, 1.0, 4.0)).rank, 2);
  EXPECT_EQ(column_rank(a, 1e-9), 2);
  EXPECT_EQ(column_rank(tall, 1e-9), 3);
  EXPECT_EQ(column_rank(tall, 0.5), 1);
}

// The four conditions of Moore and Penrose.
TEST(LinearAlgebra, PseudoInverse) {
  for (const MatrixXd& a :
       {of_rank_two(), MatrixXd(of_rank_two().transpose()), hilbert(2, 4)}) {
    const MatrixXd p = pseudo_inverse(a, 1e-9);
    EXPECT_LT((a * p * a - a).norm(), 1e-13);
    EXPECT_LT((p * a * p - p).norm(), 1e-13);
    EXPECT_LT((a * p - (a * p).transpose()).norm(), 1e-13);
    EXPECT_LT((p * a - (p * a).transpose()).norm(), 1e-13);
  }
  EXPECT_LT((inverse_by_lu(hilbert(3, 3)) - pseudo_inverse(hilbert(3, 3), 1e-9)).norm(), 1e-10);
}

TEST(LinearAlgebra, ColumnsAndSingularVectors) {
  const MatrixXd a = hilbert(5, 3);
  const MatrixXd q = orthonormal_columns(a);
  EXPECT_LT((q.transpose() * q - MatrixXd::Identity(3, 3)).norm(), 1e-14);
  EXPECT_LT((q * (q.transpose() * a) - a).norm(), 1e-14);
  const RightSingular svd = right_singular(a);
  ASSERT_EQ(svd.values.size(), 3);
  EXPECT_TRUE((a * svd.vectors).colwise().norm().transpose().isApprox(svd.values, 1e-13));
  // What is not seen: the right vector of a zero.
  const RightSingular flat = right_singular(of_rank_two());
  EXPECT_LT(flat.values[2], 1e-14);
  EXPECT_LT((of_rank_two() * flat.vectors.col(2)).norm(), 1e-14);
}

}  // namespace
}  // namespace haarlight
