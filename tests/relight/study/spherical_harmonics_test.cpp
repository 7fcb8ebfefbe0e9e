// SPDX-License-Identifier: Apache-2.0
#include "relight/study/spherical_harmonics.h"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

constexpr double kPi = std::numbers::pi;

/// The golden-angle spiral over the whole sphere.
std::vector<Vector3d> spiral(int n, double lowest = -1.0) {
  std::vector<Vector3d> directions;
  for (int k = 0; k < n; ++k) {
    const double z = lowest + (1.0 - lowest) * (k + 0.5) / n;
    const double r = std::sqrt(1.0 - z * z);
    const double angle = kPi * (3.0 - std::sqrt(5.0)) * k;
    directions.emplace_back(r * std::cos(angle), r * std::sin(angle), z);
  }
  return directions;
}

TEST(SphericalHarmonics, AreThePolynomialsOfTheBooks) {
  const Vector3d d = Vector3d(0.3, -0.5, 0.7).normalized();
  const std::vector<double> y = spherical_harmonics(d, 2);
  EXPECT_NEAR(y[0], 0.5 / std::sqrt(kPi), 1e-15);
  const double first = std::sqrt(3.0 / (4.0 * kPi));
  EXPECT_NEAR(y[1], first * d.y(), 1e-15);
  EXPECT_NEAR(y[2], first * d.z(), 1e-15);
  EXPECT_NEAR(y[3], first * d.x(), 1e-15);
  const double second = 0.5 * std::sqrt(15.0 / kPi);
  EXPECT_NEAR(y[4], second * d.x() * d.y(), 1e-15);
  EXPECT_NEAR(y[5], second * d.y() * d.z(), 1e-15);
  EXPECT_NEAR(y[6], 0.25 * std::sqrt(5.0 / kPi) * (3.0 * d.z() * d.z() - 1.0), 1e-15);
  EXPECT_NEAR(y[7], second * d.x() * d.z(), 1e-15);
  EXPECT_NEAR(y[8], 0.5 * second * (d.x() * d.x() - d.y() * d.y()), 1e-15);
}

TEST(SphericalHarmonics, SquaresOfAnOrderAddUpToAConstant) {
  // Unsoeld: sum over m of Y_lm^2 = (2 l + 1)/(4 pi), everywhere.
  for (const Vector3d& d : {Vector3d(0, 0, 1), Vector3d(1, 0, 0),
                            Vector3d(Vector3d(-0.2, 0.9, -0.4).normalized())}) {
    const std::vector<double> y = spherical_harmonics(d, 20);
    for (int l = 0; l <= 20; ++l) {
      double sum = 0.0;
      for (int m = -l; m <= l; ++m) {
        const int at = l * (l + 1) + m;
        sum += std::pow(y[static_cast<std::size_t>(at)], 2);
      }
      EXPECT_NEAR(sum * 4.0 * kPi / (2.0 * l + 1.0), 1.0, 1e-12) << l;
    }
  }
}

TEST(SphericalHarmonics, AreOrthonormalOverTheSphere) {
  // Gauss-Legendre would be exact; 200 000 points of a spiral integrate order 4 to 1e-4.
  const int n = 200000;
  Eigen::MatrixXd gram = Eigen::MatrixXd::Zero(25, 25);
  for (const Vector3d& d : spiral(n)) {
    const std::vector<double> y = spherical_harmonics(d, 4);
    const Eigen::Map<const Eigen::VectorXd> v(y.data(), 25);
    gram += 4.0 * kPi / n * v * v.transpose();
  }
  EXPECT_LT((gram - Eigen::MatrixXd::Identity(25, 25)).cwiseAbs().maxCoeff(), 1e-4);
}

/// What the transform keeps of one pixel's lights.
std::vector<float> projected(const LightBasis& transform, const std::vector<float>& lights) {
  std::vector<float> coefficients(static_cast<std::size_t>(transform.n_coefficients()));
  std::vector<float> back(lights.size());
  transform.analyse(lights, coefficients);
  transform.synthesise(coefficients, back);
  return back;
}

TEST(SphericalHarmonics, FitKeepsConstantsAndLinearFunctionsOfTheDirection) {
  for (const double lowest : {-1.0, 0.85}) {  // the sphere, and a face's cap of 32 degrees
    const std::vector<Vector3d> directions = spiral(300, lowest);
    const auto transform = make_spherical_harmonics(directions, 1);
    ASSERT_EQ(transform->n_coefficients(), 4);
    EXPECT_FALSE(transform->is_complete());
    std::vector<float> constant(300, 2.0F);
    std::vector<float> linear;
    for (const Vector3d& d : directions) {
      linear.push_back(static_cast<float>(1.0 + 0.5 * d.x() - 2.0 * d.y() + 0.7 * d.z()));
    }
    const std::vector<float> c = projected(*transform, constant);
    const std::vector<float> l = projected(*transform, linear);
    for (std::size_t k = 0; k < 300; ++k) {
      EXPECT_NEAR(c[k], 2.0, 1e-5);
      EXPECT_NEAR(l[k], linear[k], 1e-5);
    }
    // The first pattern is the constant: its coefficient is the sum over sqrt(n).
    std::vector<float> coefficients(4);
    transform->analyse(constant, coefficients);
    EXPECT_NEAR(coefficients[0], 2.0 * std::sqrt(300.0), 1e-3);
    for (std::size_t i = 1; i < 4; ++i) {
      EXPECT_NEAR(coefficients[i], 0.0, 1e-4);
    }
  }
}

TEST(SphericalHarmonics, ProjectionMissesWhatIsBeyondItsOrder) {
  // One lit light is no smooth function: the fit of order 3 keeps 16 of 500 parts of it.
  const std::vector<Vector3d> directions = spiral(500);
  const auto transform = make_spherical_harmonics(directions, 3);
  std::vector<float> one(500);
  one[77] = 1.0F;
  const std::vector<float> kept = projected(*transform, one);
  EXPECT_NEAR(kept[77], 16.0 / 500.0, 1e-3);
}

TEST(SphericalHarmonics, FunctionsThatFewLightsCannotTellApartAreLeftOut) {
  const auto transform = make_spherical_harmonics(spiral(7), 6);
  EXPECT_EQ(transform->n_coefficients(), 7);
  EXPECT_TRUE(transform->is_complete());
  const std::vector<Vector3d> same(5, Vector3d::UnitZ());
  EXPECT_EQ(make_spherical_harmonics(same, 4)->n_coefficients(), 1);
  const auto one = make_spherical_harmonics({Vector3d::UnitX()}, 15);
  EXPECT_EQ(one->n_coefficients(), 1);
}

}  // namespace
}  // namespace haarlight::relight
