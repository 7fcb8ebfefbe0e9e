// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/light_interpolation.h"

#include <cmath>

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "haarlight/core/error.h"
#include "relight/reflectance/fit/parameter_choice.h"
#include "tests/relight/reflectance/fit/synthetic_lights.h"

namespace haarlight::relight {
namespace {

using testing::spiral_lights;

LightInterpolation kriging(KrigingKernel kernel, double noise) {
  LightInterpolation interpolation;
  interpolation.kind = InterpolationKind::kriging;
  interpolation.kernel = kernel;
  interpolation.ridge = noise;
  return interpolation;
}

/// Leaving out a light by interpolating again without it.
double predicted_without(const LightInterpolation& interpolation,
                         std::vector<Eigen::Vector3d> lights, const Eigen::VectorXd& values,
                         int i) {
  const Eigen::Vector3d at = lights[static_cast<std::size_t>(i)];
  lights.erase(lights.begin() + i);
  Eigen::VectorXd others(values.size() - 1);
  others << values.head(i), values.tail(values.size() - i - 1);
  return interpolation_weights(interpolation, lights, {at}).row(0) * others;
}

TEST(LightInterpolation, TermsInTheBasisComeBack) {
  const auto lights = spiral_lights(30);
  for (const auto& [basis, n] :
       {std::pair{ReflectanceBasis::ptm, 6}, std::pair{ReflectanceBasis::hsh, 4},
        std::pair{ReflectanceBasis::hsh, 9}, std::pair{ReflectanceBasis::hsh, 16}}) {
    LightInterpolation interpolation;
    interpolation.basis = basis;
    interpolation.n_terms = n;
    const Eigen::VectorXd coefficients = Eigen::VectorXd::LinSpaced(n, -1.0, 2.0);
    const Eigen::VectorXd values = terms_of(basis, n, lights) * coefficients;
    // 30 x 16 least squares of condition below 100: 1e-12.
    EXPECT_LT(
        (term_matrix(interpolation, lights) * values - coefficients).cwiseAbs().maxCoeff(),
        1e-12);
  }
}

TEST(LightInterpolation, KrigingContinuesAMatteSurfaceExactly) {
  // Lambert without attached shadow is linear in the direction: the drift has it whole.
  const auto lights = spiral_lights(20);
  const auto others = spiral_lights(37, 0.05);
  const Eigen::Vector3d normal = Eigen::Vector3d(0.2, -0.3, 0.9).normalized();
  for (const KrigingKernel kernel : {KrigingKernel::linear, KrigingKernel::thin_plate,
                                     KrigingKernel::cubic, KrigingKernel::matern}) {
    const Eigen::MatrixXd weights =
        interpolation_weights(kriging(kernel, 0.01), lights, others);
    Eigen::VectorXd values(20);
    for (int i = 0; i < 20; ++i) {
      values[i] = normal.dot(lights[static_cast<std::size_t>(i)]);
    }
    const Eigen::VectorXd found = weights * values;
    for (int i = 0; i < 37; ++i) {
      EXPECT_NEAR(found[i], normal.dot(others[static_cast<std::size_t>(i)]), 1e-10);
    }
  }
}

TEST(LightInterpolation, LeavingOneOutInClosedFormIsLeavingOneOut) {
  const auto lights = spiral_lights(24);
  Eigen::VectorXd values(24);
  for (int i = 0; i < 24; ++i) {
    values[i] = std::sin(5.0 * lights[static_cast<std::size_t>(i)].x()) + 0.1 * i;
  }
  LightInterpolation terms;
  terms.n_terms = 9;
  LightInterpolation radial;
  radial.kind = InterpolationKind::radial;
  radial.width = 0.5;
  radial.ridge = 0.01;
  for (const LightInterpolation& interpolation :
       {terms, kriging(KrigingKernel::thin_plate, 0.01), kriging(KrigingKernel::matern, 0.1),
        kriging(KrigingKernel::linear, 1e-4), radial}) {
    const Eigen::VectorXd residual = leave_one_out(interpolation, lights) * values;
    for (int i = 0; i < 24; ++i) {
      EXPECT_NEAR(values[i] - residual[i], predicted_without(interpolation, lights, values, i),
                  1e-8)
          << describe(interpolation) << ", light " << i;
    }
  }
}

RC_GTEST_PROP(LightInterpolation, WeightsOfAConstantSumToOne, ()) {
  const int n = *rc::gen::inRange(5, 40);
  const auto lights = spiral_lights(n, 0.01 * *rc::gen::inRange(1, 80));
  LightInterpolation radial;
  radial.kind = InterpolationKind::radial;
  radial.width = 0.4;
  radial.ridge = 0.01;
  for (const LightInterpolation& interpolation :
       {kriging(KrigingKernel::cubic, 0.01), radial}) {
    const Eigen::VectorXd sums =
        interpolation_weights(interpolation, lights, spiral_lights(11)).rowwise().sum();
    RC_ASSERT((sums.array() - 1.0).abs().maxCoeff() < 1e-6);
  }
}

TEST(LightInterpolation, OctahedralNodesAreWhereTheFormatsSay) {
  ReflectanceModel model;
  model.basis = ReflectanceBasis::bilinear;
  model.colour = ReflectanceColour::pca;
  model.resolution = 9;
  for (int row = 0; row < 9; ++row) {
    for (int column = 0; column < 9; ++column) {
      double own = 0.0;
      for (const NodeWeight& weight :
           node_weights(model, octahedral_direction(row, column, 9))) {
        own += weight.node == row * 9 + column ? weight.weight : 0.0;
      }
      EXPECT_NEAR(own, 1.0, 1e-12);
    }
  }
}

TEST(LightInterpolation, FewerLightsThanTermsFollowTheRidge) {
  LightInterpolation interpolation;
  interpolation.n_terms = 9;
  interpolation.ridge = 1e-4;
  const auto lights = spiral_lights(5);
  const Eigen::MatrixXd matrix = term_matrix(interpolation, lights);
  EXPECT_TRUE(matrix.allFinite());
  // A constant stays one: the ridge does not bend it.
  const Eigen::VectorXd found =
      terms_of(interpolation.basis, 9, spiral_lights(13)) * matrix * Eigen::VectorXd::Ones(5);
  EXPECT_LT((found.array() - 1.0).abs().maxCoeff(), 1e-6);
  EXPECT_EQ(terms_condition(interpolation.basis, 9, lights).rank, 5);
}

TEST(LightInterpolation, CoincidentLightsCountAsTheirMean) {
  auto lights = spiral_lights(12);
  lights.push_back(lights[3]);
  Eigen::VectorXd values = Eigen::VectorXd::Constant(13, 0.5);
  values[3] = 0.4;
  values[12] = 0.6;
  const LightInterpolation interpolation = kriging(KrigingKernel::thin_plate, 0.01);
  const double found =
      interpolation_weights(interpolation, lights, {lights[3]}).row(0) * values;
  EXPECT_NEAR(found, 0.5, 1e-9);
  ASSERT_EQ(light_warnings(lights).size(), 1U);
  EXPECT_NE(light_warnings(lights)[0].find("3 and 12"), std::string::npos);
}

TEST(LightInterpolation, LightsInOnePlaneNameTheAmbiguousDirection) {
  std::vector<Eigen::Vector3d> fan;
  for (int i = 1; i < 10; ++i) {
    const double a = 0.1 * i * std::numbers::pi;
    fan.emplace_back(std::cos(a), 0.0, std::sin(a));
  }
  const auto warnings = light_warnings(fan);
  ASSERT_EQ(warnings.size(), 1U);
  EXPECT_NE(warnings[0].find("0.0000, 1.0000, 0.0000"), std::string::npos) << warnings[0];
  const TermsCondition condition = terms_condition(ReflectanceBasis::ptm, 6, fan);
  EXPECT_LT(condition.rank, 6);
  // v, v^2 and uv are never seen: the ambiguous combination is made of them.
  EXPECT_NEAR(condition.ambiguous[0], 0.0, 1e-9);
  EXPECT_NEAR(condition.ambiguous[3], 0.0, 1e-9);
  EXPECT_NEAR(condition.ambiguous[5], 0.0, 1e-9);
  EXPECT_TRUE(
      interpolation_weights(kriging(KrigingKernel::thin_plate, 0.01), fan, spiral_lights(9))
          .allFinite());
}

TEST(LightInterpolation, LightsOnACircleAreNamed) {
  std::vector<Eigen::Vector3d> ring;
  for (int i = 0; i < 12; ++i) {
    const double a = i * std::numbers::pi / 6.0;
    ring.emplace_back(0.8 * std::cos(a), 0.8 * std::sin(a), 0.6);
  }
  const auto warnings = light_warnings(ring);
  ASSERT_EQ(warnings.size(), 1U);
  EXPECT_NE(warnings[0].find("circle"), std::string::npos);
  EXPECT_TRUE(
      interpolation_weights(kriging(KrigingKernel::linear, 0.01), ring, spiral_lights(9))
          .allFinite());
}

TEST(LightInterpolation, NoWarningsForADome) {
  EXPECT_TRUE(light_warnings(spiral_lights(48)).empty());
}

}  // namespace
}  // namespace haarlight::relight
