// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/error_gram.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight::relight {
namespace {

using Matrix = Eigen::MatrixXd;

double noise(std::uint64_t a, std::uint64_t b) { return standard_normal(hash_key(11, a, b)); }
double noise_of(int a, int b) {
  return noise(static_cast<std::uint64_t>(a), static_cast<std::uint64_t>(b));
}

/// The products are those of the whole numbers, whatever the code, the number of lights and
/// pixels, and the order of indices.
TEST(TileErrors, ProductsAreExactWithAndWithoutVectors) {
  for (const int n_lights : {1, 5, 64, 1030}) {
    for (const std::size_t n_pixels : {std::size_t{1}, std::size_t{17}, std::size_t{100}}) {
      std::vector<int> indices(static_cast<std::size_t>(n_lights));
      std::iota(indices.rbegin(), indices.rend(), 0);
      TileErrors errors(indices, n_pixels);
      Matrix whole(n_lights, static_cast<Eigen::Index>(n_pixels));
      for (std::size_t p = 0; p < n_pixels; ++p) {
        std::vector<float> row(static_cast<std::size_t>(n_lights));
        for (std::size_t k = 0; k < row.size(); ++k) {
          row[k] = static_cast<float>(0.01 * noise(p, k));
          const double steps = double{row[k]} * 1e4;
          whole(indices[k], static_cast<Eigen::Index>(p)) =
              std::clamp(std::round(steps), -1400.0, 1400.0);
        }
        errors.append(std::span<const float>(row), 1e4);
      }
      const std::vector<std::int32_t> plain = errors.products(KernelCode::portable);
      ASSERT_EQ(plain.size(), gram_size(n_lights));
      EXPECT_EQ(plain, errors.products());
      std::size_t at = 0;
      for (int begin = 0; begin < n_lights; begin += kGramBlock) {
        const int n = std::min(kGramBlock, n_lights - begin);
        const Matrix block = whole.middleRows(begin, n);
        const Matrix truth = block * block.transpose();
        for (int i = 0; i < n; ++i) {
          for (int j = 0; j <= i; ++j, ++at) {
            ASSERT_EQ(plain[at], truth(i, j)) << n_lights << " " << n_pixels << " " << i << j;
          }
        }
      }
    }
  }
}

TEST(TileErrors, LargestErrorsOfAWholeTileFit32Bits) {
  const std::vector<int> indices = {0, 1};
  TileErrors errors(indices, 1024);
  for (int p = 0; p < 1024; ++p) {
    const std::vector<float> row = {1.0F, -1e9F};  // the second is cut: its rest says so
    errors.append(std::span<const float>(row), kGramLargest);
  }
  const std::vector<std::int32_t> products = errors.products();
  EXPECT_EQ(products[0], 1024 * kGramLargest * kGramLargest);
  EXPECT_EQ(products[1], -products[0]);
  EXPECT_GE(errors.largest_rest(), 1e9 * kGramLargest * 0.999);
}

struct Case {
  Matrix products;
  std::vector<float> norms;
  std::vector<double> lower;
};

/// Pictures of `rank` common parts and noise of their own.
Case make_case(int n, int rank, double own) {
  Matrix pictures(n, 300);
  for (int i = 0; i < n; ++i) {
    const double size =
        std::pow(10.0, -3.0 * uniform_unit(hash_key(3, static_cast<std::uint64_t>(i))));
    for (int p = 0; p < 300; ++p) {
      double v = own * noise_of(1000 + i, p);
      for (int r = 0; r < rank; ++r) {
        v += std::pow(0.7, r) * noise_of(5000 + r, p) * noise_of(9000 + r, i);
      }
      pictures(i, p) = size * v;
    }
  }
  Case made{pictures * pictures.transpose(), {}, {}};
  for (int i = 0; i < n; ++i) {
    made.norms.push_back(static_cast<float>(std::sqrt(made.products(i, i)) * (1.0 + 1e-7)));
    for (int j = 0; j <= i; ++j) {
      made.lower.push_back(made.products(i, j));
    }
  }
  return made;
}

/// The bound as a matrix: it must lie above the products in every direction.
Matrix bound_matrix(const ProductBound& bound, const std::vector<float>& norms) {
  const auto n = static_cast<Eigen::Index>(norms.size());
  Matrix all = Matrix::Identity(n, n) * double{bound.fraction};
  for (std::size_t j = 0; j * norms.size() < bound.vectors.size(); ++j) {
    Eigen::VectorXd v(n);
    for (Eigen::Index i = 0; i < n; ++i) {
      v[i] = bound.vectors[j * norms.size() + static_cast<std::size_t>(i)];
    }
    all += v * v.transpose();
  }
  for (Eigen::Index i = 0; i < n; ++i) {
    all.row(i) *= norms[static_cast<std::size_t>(i)];
    all.col(i) *= norms[static_cast<std::size_t>(i)];
  }
  return all;
}

TEST(ProductBound, LiesAboveTheProductsInEveryDirectionAndNotFar) {
  for (const int n_vectors : {0, 1, 4, 12}) {
    for (const int n : {1, 12, 40, 130}) {
      const Case made = make_case(n, 6, 0.3);
      const ProductBound bound =
          fit_product_bound(made.lower, made.norms, std::min(n, n_vectors));
      const Matrix over = bound_matrix(bound, made.norms) - made.products;
      // 1e-12: this test's own sums.
      EXPECT_GE(Eigen::SelfAdjointEigenSolver<Matrix>(over).eigenvalues()[0],
                -1e-12 * made.products.trace());
      // Sharp: with as many vectors as there are common parts only the noise is left.
      if (n_vectors == 12 && n == 130) {
        EXPECT_LT(bound.fraction, 1.5);
      }
    }
  }
}

TEST(ProductBound, PicturesWithoutErrorCostNothing) {
  const std::vector<float> norms = {0.0F, 0.0F, 0.0F};
  const ProductBound bound = fit_product_bound(std::vector<double>(6), norms, 1);
  EXPECT_LT(bound.fraction, 1e-5);
  EXPECT_TRUE(std::all_of(bound.vectors.begin(), bound.vectors.end(),
                          [](float v) { return v == 0.0F; }));
}

}  // namespace
}  // namespace haarlight::relight
