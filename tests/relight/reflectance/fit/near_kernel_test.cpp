// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/near_kernel.h"

#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include <Eigen/Dense>
#include <gtest/gtest.h>

#include "haarlight/core/picture/image_io.h"
#include "relight/reflectance/fit/fit_kernel.h"
#include "relight/reflectance/fit/light_interpolation.h"
#include "relight/reflectance/fit/wide_vectors.h"
#include "tests/relight/reflectance/fit/synthetic_lights.h"

namespace haarlight::relight {
namespace {

/// Every width of vector that this machine has.
class NearKernel : public ::testing::TestWithParam<VectorWidth> {
 protected:
  void SetUp() override {
    if (GetParam() > machine_vector_width()) {
      GTEST_SKIP() << "this machine has no such vectors";
    }
    widest_vectors = GetParam();
  }
  void TearDown() override { widest_vectors = VectorWidth::avx512; }
};
std::string name_of(const ::testing::TestParamInfo<VectorWidth>& width) {
  return std::array{"Portable", "Avx2", "Avx512"}.at(static_cast<std::size_t>(width.param));
}
INSTANTIATE_TEST_SUITE_P(Widths, NearKernel,
                         ::testing::Values(VectorWidth::portable, VectorWidth::avx2,
                                           VectorWidth::avx512),
                         name_of);

NearBlock positions() {
  NearBlock block;
  for (std::size_t k = 0; k < kNearBlock; ++k) {
    block.x[k] = -90.0F + 6.0F * static_cast<float>(k);
    block.y[k] = 40.0F - 3.0F * static_cast<float>(k);
    block.z[k] = 0.1F * static_cast<float>(k);
  }
  return block;
}

/// Above, aslant, close to the horizon, and behind the plane.
std::vector<Eigen::Vector3d> light_coordinates() {
  return {{10.0, -20.0, 300.0}, {-400.0, 250.0, 200.0}, {600.0, 10.0, 5.0}, {50.0, 50.0, -9.0}};
}

std::vector<std::uint16_t> codes_of_block() {
  std::vector<std::uint16_t> codes(3 * kNearBlock);
  for (std::size_t i = 0; i < codes.size(); ++i) {
    codes[i] = static_cast<std::uint16_t>(i * i * 7U);  // dark and bright, to 64512
  }
  return codes;
}

struct Truth {
  Eigen::Vector3d direction;
  double gain = 0.0;
};

Truth truth_at(const Eigen::Vector3d& light, const Eigen::Vector3d& axis, double mu,
               const NearBlock& block, std::size_t k) {
  const Eigen::Vector3d way =
      light - Eigen::Vector3f(block.x[k], block.y[k], block.z[k]).cast<double>();
  const double cosine = -axis.dot(way.normalized());
  const double lobe = mu == 0.0 ? 1.0 : (cosine > 0.0 ? std::pow(cosine, mu) : 0.0);
  return {way.normalized(), lobe > 1e-3 ? way.squaredNorm() / lobe : 0.0};
}

TEST_P(NearKernel, ColumnsAreTermsAndCorrectedValues) {
  const NearBlock block = positions();
  const std::vector<std::uint16_t> codes = codes_of_block();
  const Eigen::Vector3d axis = Eigen::Vector3d(0.1, -0.2, -1.0).normalized();
  for (const auto& [basis, n] :
       {std::pair{ReflectanceBasis::ptm, 6}, std::pair{ReflectanceBasis::hsh, 4},
        std::pair{ReflectanceBasis::hsh, 9}, std::pair{ReflectanceBasis::hsh, 16}}) {
    for (const double mu : {0.0, 1.0, 0.73, 4.5}) {
      for (const Eigen::Vector3d& light : light_coordinates()) {
        const double scale = 1.0 / (65535.0 * 9e4);
        const NearSource source{static_cast<float>(light.x()),
                                static_cast<float>(light.y()),
                                static_cast<float>(light.z()),
                                {static_cast<float>(axis.x()), static_cast<float>(axis.y()),
                                 static_cast<float>(axis.z())},
                                static_cast<float>(mu),
                                static_cast<float>(scale)};
        const std::size_t n_padded = near_terms_padded(n);
        for (const bool is_coded : {false, true}) {
          std::vector<float> columns((n_padded + 3) * kNearBlock, -7.0F);
          near_columns({basis, n, is_coded}, source, block, codes.data(), columns.data());
          for (std::size_t k = 0; k < kNearBlock; ++k) {
            const Truth truth = truth_at(light, axis, mu, block, k);
            const Eigen::VectorXd terms = terms_of(basis, n, {truth.direction}).row(0);
            for (std::size_t t = 0; t < n_padded; ++t) {
              const bool is_there = truth.gain > 0.0 && t < static_cast<std::size_t>(n);
              // Directions in float: 16 terms' derivatives are steep at the horizon.
              EXPECT_NEAR(columns[t * kNearBlock + k],
                          is_there ? terms[static_cast<Eigen::Index>(t)] : 0.0,
                          n == 16 ? 2e-3 : 3e-6)
                  << t << " of " << n << " at " << light.transpose();
            }
            for (std::size_t c = 0; c < 3; ++c) {
              const double linear = truth.gain * scale * codes[3 * k + c];
              const double value = columns[(n_padded + c) * kNearBlock + k];
              if (is_coded) {
                const double clipped = std::min(linear, 4.0);
                EXPECT_NEAR(value, srgb_from_linear(static_cast<float>(clipped)), 2e-5);
              } else {
                // The lobe's power: a cosine in float, to the mu-th.
                EXPECT_NEAR(value, linear, 1e-6 * (2.0 + 6.0 * mu) * linear);
              }
            }
          }
        }
      }
    }
  }
}

TEST_P(NearKernel, SolvesEachPixelsProblem) {
  const NearBlock block = positions();
  const std::vector<std::uint16_t> codes = codes_of_block();
  for (const int n : {4, 9, 16}) {
    const std::size_t n_padded = near_terms_padded(n);
    const std::size_t n_lights = 50;  // no multiple of a chunk
    std::vector<float> columns(n_lights * (n_padded + 3) * kNearBlock);
    const auto directions = testing::spiral_lights(static_cast<int>(n_lights));
    for (std::size_t l = 0; l < n_lights; ++l) {
      const Eigen::Vector3f at = (400.0 * directions[l]).cast<float>();
      near_columns({ReflectanceBasis::hsh, n, true}, {at.x(), at.y(), at.z(), {}, 0.0F, 1e-10F},
                   block, codes.data(), columns.data() + l * (n_padded + 3) * kNearBlock);
    }
    std::vector<float> sums(n_padded * (n_padded + 3) * kNearBlock);
    for (std::size_t first = 0; first < n_lights; first += kNearChunk) {
      add_near_products(columns.data() + first * (n_padded + 3) * kNearBlock,
                        std::min(kNearChunk, n_lights - first), n_padded, sums.data());
    }
    const std::vector<double> ridge(static_cast<std::size_t>(n), 0.01);
    std::vector<float> planes(3 * static_cast<std::size_t>(n) * kNearBlock);
    solve_near(sums.data(), ridge.data(), n, planes.data());
    for (std::size_t k = 0; k < kNearBlock; ++k) {
      Eigen::MatrixXd problem(n_lights, n_padded + 3);
      for (std::size_t l = 0; l < n_lights; ++l) {
        for (std::size_t i = 0; i < n_padded + 3; ++i) {
          problem(static_cast<Eigen::Index>(l), static_cast<Eigen::Index>(i)) =
              static_cast<double>(columns[(l * (n_padded + 3) + i) * kNearBlock + k]);
        }
      }
      const Eigen::MatrixXd x = problem.leftCols(n);
      const Eigen::MatrixXd normal = x.transpose() * x + 0.01 * Eigen::MatrixXd::Identity(n, n);
      const Eigen::MatrixXd truth = normal.ldlt().solve(x.transpose() * problem.rightCols(3));
      for (int c = 0; c < 3; ++c) {
        for (int i = 0; i < n; ++i) {
          // Sums in float, 1e-6 of their own; the ridge keeps the condition below 1e4.
          EXPECT_NEAR(planes[static_cast<std::size_t>(c * n + i) * kNearBlock + k], truth(i, c),
                      1e-3 * truth.cwiseAbs().maxCoeff());
        }
      }
    }
  }
}

TEST_P(NearKernel, SumsBetweenGoAlongTheLine) {
  constexpr std::size_t kLights = 5;
  for (const int n : {4, 6, 9, 16}) {
    const auto n_terms = static_cast<std::size_t>(n);
    std::vector<float> starts(kLights * n_terms);
    std::vector<float> steps(kLights * n_terms);
    std::vector<float> values(kLights * 3 * kNearBlock);
    for (std::size_t i = 0; i < starts.size(); ++i) {
      starts[i] = static_cast<float>(testing::field(static_cast<int>(i), 0, 0, 0));
      steps[i] = static_cast<float>(testing::field(static_cast<int>(i), 0, 1, 0));
    }
    for (std::size_t i = 0; i < values.size(); ++i) {
      values[i] = static_cast<float>(testing::field(static_cast<int>(i), 0, 2, 0));
    }
    std::vector<float> planes(3 * n_terms * kNearBlock, 0.25F);
    add_near_between(starts.data(), steps.data(), n, kLights, values.data(), planes.data());
    for (std::size_t c = 0; c < 3; ++c) {
      for (std::size_t t = 0; t < n_terms; ++t) {
        for (std::size_t x = 0; x < kNearStep; ++x) {
          const double along = (static_cast<double>(x) + 0.5) / static_cast<double>(kNearStep);
          double truth = 0.25;
          for (std::size_t l = 0; l < kLights; ++l) {
            const double factor = static_cast<double>(starts[l * n_terms + t]) +
                                  along * static_cast<double>(steps[l * n_terms + t]);
            truth += factor * static_cast<double>(values[(3 * l + c) * kNearBlock + x]);
          }
          EXPECT_NEAR(planes[(c * n_terms + t) * kNearBlock + x], truth, 3e-6);
        }
        EXPECT_EQ(planes[(c * n_terms + t) * kNearBlock + kNearStep], 0.25F);
      }
    }
  }
}

TEST_P(NearKernel, ATermWithoutLightIsLeftOut) {
  std::vector<float> sums(std::size_t{6} * 9 * kNearBlock);
  std::vector<float> planes(12 * kNearBlock, 1.0F);
  const std::vector<double> ridge(4, 0.0);
  solve_near(sums.data(), ridge.data(), 4, planes.data());
  EXPECT_EQ(planes, std::vector<float>(12 * kNearBlock, 0.0F));
}

TEST_P(NearKernel, ParabolasAreTheGainsBetween) {
  const NearBlock block = positions();
  NearBlock ends;
  for (std::size_t k = 0; k < 3; ++k) {
    const float at = 16.0F * static_cast<float>(k) - 0.5F;  // pixels are 6 mm apart
    ends.x[k] = -90.0F + 6.0F * at;
    ends.y[k] = 40.0F - 3.0F * at;
    ends.z[k] = 0.1F * at;
  }
  // 215 mm along the block; the lights' distance is fifty times that.
  const NearSource source{3000.0F, 9000.0F, 9000.0F, {0.0F, 0.0F, -1.0F}, 1.0F, 1.0F};
  std::vector<float> three(kNearBlock);
  near_gains(source, ends, three.data());
  EXPECT_FALSE(has_rough_gains(three.data(), 1));
  const std::vector<std::uint16_t> codes(3 * kNearBlock, 1);
  std::vector<float> found(3 * kNearBlock);
  bent_near_values(three.data(), 0, codes.data(), 0, 1, false, found.data());
  std::vector<float> gains(kNearBlock);
  near_gains(source, block, gains.data());
  std::vector<float> truth(3 * kNearBlock);
  near_values(gains.data(), codes.data(), false, truth.data());
  for (std::size_t i = 0; i < found.size(); ++i) {
    EXPECT_NEAR(found[i], truth[i], 3e-5F * truth[i]);
  }
  const std::vector<float> gap = {1.0F, 0.0F, 1.0F};
  EXPECT_TRUE(has_rough_gains(gap.data(), 1));
  const std::vector<float> steep = {1.0F, 1.1F, 1.3F};
  EXPECT_TRUE(has_rough_gains(steep.data(), 1));
}

/// All that the kernels give, one after the other.
std::vector<float> everything() {
  const NearBlock block = positions();
  const std::vector<std::uint16_t> codes = codes_of_block();
  std::vector<float> all;
  constexpr std::size_t kLights = 20;
  constexpr std::size_t kColumns = 12 * kNearBlock;
  std::vector<float> columns(kLights * kColumns);
  const auto directions = testing::spiral_lights(static_cast<int>(kLights));
  for (std::size_t l = 0; l < kLights; ++l) {
    const Eigen::Vector3f at = (400.0 * directions[l]).cast<float>();
    const NearSource source{
        at.x(), at.y(), at.z(), {0.0F, 0.6F, -0.8F}, l % 2 == 0 ? 0.73F : 1.0F, 1e-10F};
    near_columns({ReflectanceBasis::hsh, 9, l % 3 != 0}, source, block, codes.data(),
                 columns.data() + l * kColumns);
  }
  all.insert(all.end(), columns.begin(), columns.end());
  std::vector<float> sums(9 * kColumns);
  add_near_products(columns.data(), kLights, 9, sums.data());
  all.insert(all.end(), sums.begin(), sums.end());
  std::vector<float> planes(27 * kNearBlock);
  const std::vector<double> ridge(9, 0.01);
  solve_near(sums.data(), ridge.data(), 9, planes.data());
  all.insert(all.end(), planes.begin(), planes.end());
  add_near_between(columns.data(), columns.data() + 77, 9, kLights, columns.data(),
                   planes.data());
  all.insert(all.end(), planes.begin(), planes.end());
  std::vector<float> values(3 * kNearBlock);
  const std::vector<float> gains = {1e-5F, 1.1e-5F, 1.15e-5F};
  bent_near_values(gains.data(), 0, codes.data(), 0, 1, true, values.data());
  all.insert(all.end(), values.begin(), values.end());
  const FitMatrix matrix(Eigen::MatrixXd::Random(4, 3));
  std::vector<float> out(6 * kNearBlock);
  matrix.multiply(codes.data(), kNearBlock, kNearBlock, out.data(), kNearBlock);
  all.insert(all.end(), out.begin(), out.end());
  matrix.multiply(columns.data(), kNearBlock, kNearBlock, out.data(), kNearBlock);
  all.insert(all.end(), out.begin(), out.end());
  return all;
}

TEST(VectorWidth, TheBitsAreTheSameWithAvx2AndAvx512) {
  if (machine_vector_width() < VectorWidth::avx512) {
    GTEST_SKIP() << "this machine has no AVX-512";
  }
  std::srand(1);
  const std::vector<float> wide = everything();
  widest_vectors = VectorWidth::avx2;
  std::srand(1);
  const std::vector<float> narrow = everything();
  widest_vectors = VectorWidth::avx512;
  ASSERT_EQ(wide.size(), narrow.size());
  EXPECT_EQ(std::memcmp(wide.data(), narrow.data(), wide.size() * sizeof(float)), 0);
}

}  // namespace
}  // namespace haarlight::relight
