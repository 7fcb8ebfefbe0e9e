// SPDX-License-Identifier: Apache-2.0
#include "relight/study/pca.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight::relight {
namespace {

/// Rows that fall in strength over hidden directions, (n, n_lights).
std::vector<float> made_rows(std::size_t n, std::size_t n_lights) {
  std::vector<float> rows(n * n_lights);
  for (std::size_t p = 0; p < n; ++p) {
    for (std::size_t j = 0; j < 10; ++j) {
      const double a = standard_normal(hash_key(1, p, j)) * std::pow(0.5, double(j));
      for (std::size_t k = 0; k < n_lights; ++k) {
        rows[p * n_lights + k] += static_cast<float>(a * standard_normal(hash_key(2, j, k)));
      }
    }
  }
  return rows;
}

Eigen::MatrixXd as_matrix(const std::vector<float>& rows, Eigen::Index n_lights) {
  using RowsOfFloat = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  return Eigen::Map<const RowsOfFloat>(
             rows.data(), static_cast<Eigen::Index>(rows.size()) / n_lights, n_lights)
      .cast<double>();
}

TEST(LightCovariance, IsTheProductOfTheRowsHoweverCut) {
  const std::vector<float> rows = made_rows(700, 70);
  LightCovariance whole(70);
  whole.add(rows);
  LightCovariance parts(70);
  parts.add(std::span(rows).first(21000));
  parts.add(std::span(rows).subspan(21000));
  const Eigen::MatrixXd m = as_matrix(rows, 70);
  const Eigen::MatrixXd direct = m.transpose() * m;
  const double scale = direct.diagonal().maxCoeff();
  EXPECT_LT((whole.matrix() - direct).cwiseAbs().maxCoeff(), 1e-13 * scale);
  EXPECT_LT((parts.matrix() - direct).cwiseAbs().maxCoeff(), 1e-13 * scale);
}

TEST(PrincipalVectors, AreTheSingularVectorsOfTheRows) {
  const std::vector<float> rows = made_rows(400, 40);
  LightCovariance covariance(40);
  covariance.add(rows);
  const PrincipalVectors found = principal_vectors(covariance.matrix(), 6);
  const Eigen::JacobiSVD<Eigen::MatrixXd> svd(as_matrix(rows, 40), Eigen::ComputeThinV);
  ASSERT_EQ(found.vectors.cols(), 6);
  for (Eigen::Index i = 0; i < 6; ++i) {
    EXPECT_NEAR(std::abs(svd.matrixV().col(i).dot(found.vectors.col(i))), 1.0, 1e-6) << i;
    EXPECT_NEAR(found.energies[i] / std::pow(svd.singularValues()[i], 2), 1.0, 1e-5) << i;
    EXPECT_GT(found.vectors.col(i).sum(), 0.0);
  }
}

TEST(PrincipalVectors, BySubspaceIterationAreTheSame) {
  LightCovariance covariance(90);
  covariance.add(made_rows(300, 90));
  const PrincipalVectors exact = principal_vectors(covariance.matrix(), 8);
  const PrincipalVectors iterated = principal_vectors(covariance.matrix(), 8, 50);
  ASSERT_EQ(iterated.vectors.cols(), 8);
  for (Eigen::Index i = 0; i < 8; ++i) {
    EXPECT_NEAR(iterated.vectors.col(i).dot(exact.vectors.col(i)), 1.0, 1e-6) << i;
  }
}

TEST(PrincipalVectors, EndWhereNothingIsLeft) {
  LightCovariance covariance(60);
  covariance.add(made_rows(300, 60));  // of rank 10
  EXPECT_EQ(principal_vectors(covariance.matrix(), 40).vectors.cols(), 10);
}

TEST(PcaTransform, OfFullRankGivesTheLightsBackThoughItsVectorsAreRounded) {
  const std::vector<float> rows = made_rows(200, 10);
  LightCovariance covariance(10);
  covariance.add(rows);
  const auto transform = make_pca_transform(principal_vectors(covariance.matrix(), 10));
  ASSERT_EQ(transform->n_coefficients(), 10);
  EXPECT_TRUE(transform->is_complete());
  EXPECT_TRUE(transform->is_ranked());
  EXPECT_EQ(transform->table_bytes(3), 3U * 10U * 2U);
  std::vector<float> coefficients(rows.size());
  std::vector<float> back(rows.size());
  transform->analyse(rows, coefficients);
  transform->synthesise(coefficients, back);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    EXPECT_NEAR(back[i], rows[i], 2e-5);
  }
}

TEST(PcaTransform, OfItsFirstVectorsIsThatOfTheOthersAtNothing) {
  const std::vector<float> rows = made_rows(50, 20);
  LightCovariance covariance(20);
  covariance.add(rows);
  const auto transform = make_pca_transform(principal_vectors(covariance.matrix(), 6));
  std::vector<float> coefficients(300);
  transform->analyse(rows, coefficients);
  std::vector<float> first(rows.size());
  transform->synthesise_first(coefficients, 2, first);
  for (std::size_t p = 0; p < 50; ++p) {
    std::fill_n(coefficients.begin() + static_cast<std::ptrdiff_t>(6 * p + 2), 4, 0.0F);
  }
  std::vector<float> cut(rows.size());
  transform->synthesise(coefficients, cut);
  for (std::size_t i = 0; i < cut.size(); ++i) {
    EXPECT_NEAR(first[i], cut[i], 1e-6);
  }
}

TEST(PcaTransform, IsTheBestProjectionOfItsRank) {
  // Eckart and Young: what r vectors miss is the energy of the other singular values.
  const std::vector<float> rows = made_rows(300, 50);
  LightCovariance covariance(50);
  covariance.add(rows);
  const auto transform = make_pca_transform(principal_vectors(covariance.matrix(), 4));
  std::vector<float> coefficients(1200);
  std::vector<float> back(rows.size());
  transform->analyse(rows, coefficients);
  transform->synthesise(coefficients, back);
  double missed = 0.0;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    missed += std::pow(double{back[i]} - double{rows[i]}, 2);
  }
  const Eigen::JacobiSVD<Eigen::MatrixXd> svd(as_matrix(rows, 50));
  const double least = svd.singularValues().tail(svd.singularValues().size() - 4).squaredNorm();
  EXPECT_NEAR(missed / least, 1.0, 1e-4);  // half floats turn the vectors by 2^-12
}

}  // namespace
}  // namespace haarlight::relight
