// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/rig/patterns.h"

#include <numeric>

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "tests/core/rig/pattern_matrices.h"

namespace haarlight {
namespace {

Eigen::MatrixXd pictures(int n_lights, int n_pixels) {
  Eigen::MatrixXd t(n_lights, n_pixels);
  for (int k = 0; k < n_lights; ++k) {
    for (int p = 0; p < n_pixels; ++p) {
      t(k, p) = uniform_unit(
          hash_key(7, static_cast<std::uint64_t>(k), static_cast<std::uint64_t>(p)));
    }
  }
  return t;
}

void expect_recovered(const PatternMatrix& patterns) {
  const Eigen::MatrixXd truth = pictures(static_cast<int>(patterns.cols()), 3);
  const Eigen::MatrixXd back = test::demultiplex(patterns, patterns * truth);
  // The patterns' condition numbers are below 64 here: 64 * sums of <= 64 terms * 2^-52 <
  // 1e-12.
  EXPECT_LT((back - truth).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(SMatrix, HasTheWeighingDesignsInverse) {
  for (const int n : {3, 7, 11, 15, 19, 23, 31, 63}) {
    const Eigen::MatrixXd s = test::matrix_of({PatternFamily::s_matrix, {{1, n}}, 0, {}});
    EXPECT_EQ(s, Eigen::MatrixXd(test::s_matrix(n))) << n;
    // S^-1 = 2/(n + 1) (2 S^T - J) [Sloane79]
    const Eigen::MatrixXd inverse =
        2.0 / (n + 1) * (2.0 * s.transpose() - Eigen::MatrixXd::Ones(n, n));
    EXPECT_LT((s * inverse - Eigen::MatrixXd::Identity(n, n)).cwiseAbs().maxCoeff(), 1e-12)
        << n;
    EXPECT_EQ(s.row(0).sum(), (n + 1) / 2);
    EXPECT_EQ(s.rowwise().sum().maxCoeff(), s.rowwise().sum().minCoeff());
    expect_recovered(s);
  }
}

TEST(SMatrix, ExistsForPowersOfTwoLessOneAndPrimesThreeModuloFour) {
  EXPECT_TRUE(has_s_matrix(1019));
  EXPECT_TRUE(has_s_matrix(1023));
  EXPECT_TRUE(has_s_matrix(15));
  EXPECT_FALSE(has_s_matrix(1024));
  EXPECT_FALSE(has_s_matrix(13));  // prime, but 1 mod 4
  EXPECT_FALSE(has_s_matrix(35));  // 3 mod 4, but not prime
  EXPECT_FALSE(has_s_matrix(1));
}

TEST(SMatrix, BlocksHoldEveryLightOnce) {
  for (int n = 1; n <= 300; ++n) {
    int next = 0;
    for (const SBlock& block : s_blocks(n)) {
      EXPECT_EQ(block.first_light, next);
      EXPECT_TRUE(block.order == 1 ? block.n_lights == 1 : has_s_matrix(block.order)) << n;
      EXPECT_LE(block.n_lights, block.order);
      next += block.n_lights;
    }
    EXPECT_EQ(next, n);
  }
  ASSERT_EQ(s_blocks(1024).size(), 2U);
  EXPECT_EQ(s_blocks(1024)[0].order, 1023);
  EXPECT_EQ(s_blocks(1024)[1].order, 1);
  EXPECT_EQ(s_blocks(100)[0].order, 103);
}

TEST(HaarPatterns, PairsGiveTheWaveletsAndTellTheLightsApart) {
  PatternParameters parameters{PatternFamily::haar, {{4, 4}}, 0, {}};
  parameters.wavelets.resize(16);
  std::iota(parameters.wavelets.begin(), parameters.wavelets.end(), 0);
  const PatternMatrix patterns = test::matrix_of(parameters);
  ASSERT_EQ(patterns.rows(), 31);
  for (int shot = 1; shot < 31; shot += 2) {
    const Eigen::RowVectorXd wavelet = patterns.row(shot) - patterns.row(shot + 1);
    EXPECT_EQ(wavelet.sum(), 0.0);
    for (int other = 1; other < shot; other += 2) {
      EXPECT_EQ(wavelet.dot(patterns.row(other) - patterns.row(other + 1)), 0.0);
    }
  }
  expect_recovered(patterns);
}

TEST(Bins, LightEveryLightOnce) {
  const PatternMatrix patterns = test::matrix_of({PatternFamily::bins, {{8, 8}}, 2, {}});
  EXPECT_EQ(patterns.rows(), 16);
  EXPECT_EQ(patterns.colwise().sum(), Eigen::RowVectorXd::Ones(64));
  EXPECT_EQ(patterns(0, 0) + patterns(0, 1) + patterns(0, 8) + patterns(0, 9), 4.0);
}

TEST(Demultiplex, RefusesPatternsThatCannotTellLightsApart) {
  const PatternMatrix bins = test::matrix_of({PatternFamily::bins, {{4, 4}}, 2, {}});
  EXPECT_THROW((void)test::demultiplex(bins, Eigen::MatrixXd::Ones(4, 1)), ContractViolation);
  expect_recovered(test::matrix_of({PatternFamily::one_at_a_time, {{1, 5}}, 0, {}}));
}

}  // namespace
}  // namespace haarlight
