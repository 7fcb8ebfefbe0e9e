// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/near_calibration.h"

#include <cmath>
#include <filesystem>

#include <Eigen/Cholesky>
#include <Eigen/Dense>
#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "relight/calibration/light_likelihood.h"
#include "relight/calibration/variance_objective.h"
#include "tests/relight/calibration/mat_file.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

/// D written out once more, for numbers that carry their derivatives: equation (7) with a lobe.
template <class T>
T variance_in(const TargetSamples& s, const std::vector<NearLight>& lights,
              const std::vector<T>& x, const T& mu) {
  using std::pow;
  using std::sqrt;
  T sum(0.0);
  double count = 0.0;
  const std::size_t n_lights = lights.size();
  const auto n_channels = static_cast<std::size_t>(s.n_channels);
  for (std::size_t p = 0; p < s.n_points(); ++p) {
    std::vector<T> s1(n_channels, T(0.0));
    std::vector<T> s2(n_channels, T(0.0));
    double used = 0.0;
    for (std::size_t k = 0; k < n_lights; ++k) {
      if (s.used(static_cast<int>(k))[p] == 0) {
        continue;
      }
      used += 1.0;
      const T* own = x.data() + k * (3 + n_channels);
      T w[3];
      T r2(0.0);
      T facing(0.0);
      T off(0.0);
      for (int c = 0; c < 3; ++c) {
        w[c] = own[c] - s.points_mm[p][c];
        r2 = r2 + w[c] * w[c];
        facing = facing + s.normals[p][c] * w[c];
        off = off - lights[k].axis[c] * w[c];
      }
      const T r = sqrt(r2);
      const T g = r2 * r / facing / pow(off / r, mu);
      for (std::size_t c = 0; c < n_channels; ++c) {
        const T a = static_cast<double>(s.values(static_cast<int>(k), static_cast<int>(c))[p]) *
                    g / own[3 + c];
        s1[c] = s1[c] + a;
        s2[c] = s2[c] + a * a;
      }
    }
    if (used < 2.0) {
      continue;
    }
    count += 1.0;
    for (std::size_t c = 0; c < n_channels; ++c) {
      sum = sum + 1.0 - s1[c] * s1[c] / (used * s2[c]);
    }
  }
  return sum / count;
}

SimulatedTarget small_target(int n = 24) {
  SimulatedTarget target;
  target.rows = target.cols = n;
  target.albedo_spread = 0.1;
  target.vignetting = 0.2;
  return target;
}

std::vector<NearLight> dome(int n, double height_mm, std::uint64_t seed) {
  std::vector<NearLight> lights;
  for (int k = 0; k < n; ++k) {
    const auto u = [&](std::uint64_t i) {
      return uniform_unit(hash_key(seed, static_cast<std::uint64_t>(k), i));
    };
    NearLight light;
    const double angle = 2.4 * k;
    const double out = 250.0 * std::sqrt((k + 0.5) / n);
    light.position_mm = {out * std::cos(angle), out * std::sin(angle),
                         height_mm * (0.9 + 0.2 * u(0))};
    light.mu = 1.0;
    light.power = Vector3d(0.7 + 0.6 * u(1), 0.7 + 0.6 * u(2), 0.7 + 0.6 * u(3));
    lights.push_back(light);
  }
  return lights;
}

double furthest(const LightCalibration& found, const std::vector<NearLight>& truth) {
  double apart = 0.0;
  for (std::size_t k = 0; k < truth.size(); ++k) {
    apart = std::max(apart, (found.lights[k].light.position_mm - truth[k].position_mm).norm());
  }
  return apart;
}

TEST(NormalisedVariance, GradientIsThatOfAutomaticDifferentiation) {
  std::vector<NearLight> lights = dome(5, 300.0, 3);
  for (NearLight& light : lights) {
    light.mu = 1.3;
    light.axis = Vector3d(-0.2, 0.1, -1.0).normalized();
  }
  SimulatedTarget target = small_target(6);
  target.n_channels = 3;
  target.height = [](double x, double y) { return 1e-3 * (x * x - 0.5 * x * y); };
  TargetSamples s = simulate_target(lights, target);
  for (std::size_t i = 0; i < s.is_used.size(); i += 7) {
    s.is_used[i] = 0;  // masks count
  }
  s.is_used[1] = s.is_used[37] = s.is_used[73] = s.is_used[109] = 0;  // one light left of five
  // Somewhere else than the truth, where D is not flat.
  for (std::size_t k = 0; k < lights.size(); ++k) {
    lights[k].position_mm += Vector3d(11.0, -7.0 * static_cast<double>(k), 23.0);
  }
  constexpr int kUnknowns = 5 * 6 + 1;
  using Jet = ceres::Jet<double, kUnknowns>;
  std::vector<Jet> x;
  for (const NearLight& light : lights) {
    for (int c = 0; c < 3; ++c) {
      x.emplace_back(light.position_mm[c], static_cast<int>(x.size()));
    }
    for (int c = 0; c < 3; ++c) {
      x.emplace_back(light.power[c], static_cast<int>(x.size()));
    }
  }
  const Jet truth = variance_in<Jet>(s, lights, x, Jet(1.3, kUnknowns - 1));
  const VarianceValue value = normalised_variance(s, lights, true);
  EXPECT_NEAR(value.d, truth.a, 1e-13 * truth.a);
  const double scale = truth.v.head(kUnknowns).cwiseAbs().maxCoeff();
  ASSERT_GT(truth.a, 1e-4);
  for (std::size_t k = 0; k < lights.size(); ++k) {
    const auto at = static_cast<Eigen::Index>(6 * k);
    for (int c = 0; c < 3; ++c) {
      // Relative to the gradient of the light: 1e-10 is what is promised.
      const double of_position = truth.v.segment<3>(at).norm();
      EXPECT_NEAR(value.gradient.position[k][c], truth.v[at + c], 1e-10 * of_position);
      const double log_power = truth.v[at + 3 + c] * lights[k].power[c];
      EXPECT_NEAR(value.gradient.log_power[3 * k + static_cast<std::size_t>(c)], log_power,
                  1e-10 * std::abs(log_power) + 1e-14 * scale);
    }
  }
  EXPECT_NEAR(value.gradient.mu, truth.v[kUnknowns - 1], 1e-10 * std::abs(value.gradient.mu));
}

TEST(NormalisedVariance, AxisGradientIsThatOfDifferences) {
  std::vector<NearLight> lights = dome(4, 300.0, 5);
  const TargetSamples s = simulate_target(lights, small_target(8));
  lights[2].position_mm.x() += 40.0;
  const VarianceValue value = normalised_variance(s, lights, true);
  for (int c = 0; c < 2; ++c) {
    const double h = 1e-5;
    const auto at = [&](double d) {
      std::vector<NearLight> moved = lights;
      moved[1].axis[c] += d;
      return normalised_variance(s, moved, false).d;
    };
    const double slope = (at(h) - at(-h)) / (2 * h);
    EXPECT_NEAR(value.gradient.axis[1][c], slope, 1e-5 * std::abs(slope));
  }
}

TEST(NormalisedVariance, IsZeroAtTheTruthAndKnowsNoScale) {
  std::vector<NearLight> lights = dome(6, 300.0, 1);
  SimulatedTarget target = small_target(10);
  target.noise = 0.0;
  const TargetSamples s = simulate_target(lights, target);
  // Samples are floats: the variance of their rounding, 2^-25 each.
  EXPECT_LT(normalised_variance(s, lights, false).d, 1e-14);
  for (NearLight& light : lights) {
    light.power *= 7.0;
  }
  EXPECT_LT(normalised_variance(s, lights, false).d, 1e-14);
  lights[0].position_mm.z() = 1e7;  // very far: its part of A outgrows the others
  EXPECT_GT(normalised_variance(s, lights, false).d, 0.8);
  EXPECT_LE(normalised_variance(s, lights, false).d, 1.0 - 1.0 / 6.0);
  lights[0].position_mm.z() = -10.0;
  EXPECT_TRUE(std::isnan(normalised_variance(s, lights, false).d));
}

/// The information of all unknowns at once, by differences of ln I: nothing eliminated.
TEST(LightBounds, AreTheInverseOfTheWholeInformation) {
  const std::vector<NearLight> lights = dome(4, 200.0, 2);
  TargetSamples s = simulate_target(lights, small_target(7));
  s.is_used[3] = s.is_used[60] = 0;
  const std::size_t n = s.n_points();
  const std::vector<double> albedo(n, 0.8);
  const auto n_unknowns = static_cast<Eigen::Index>(4 * lights.size() + n + 1);
  Eigen::MatrixXd information = Eigen::MatrixXd::Zero(n_unknowns, n_unknowns);
  for (std::size_t k = 0; k < lights.size(); ++k) {
    for (std::size_t p = 0; p < n; ++p) {
      if (s.used(static_cast<int>(k))[p] == 0) {
        continue;
      }
      const auto log_i = [&](int which, double d) {
        NearLight light = lights[k];
        if (which < 3) {
          light.position_mm[which] += d;
        } else {
          light.mu += d;
        }
        return std::log(light_stencil(light, s.points_mm[p], s.normals[p]));
      };
      Eigen::VectorXd row = Eigen::VectorXd::Zero(n_unknowns);
      for (int c = 0; c < 3; ++c) {
        row[static_cast<Eigen::Index>(4 * k) + c] = (log_i(c, 1e-3) - log_i(c, -1e-3)) / 2e-3;
      }
      row[static_cast<Eigen::Index>(4 * k) + 3] = 1.0;
      row[static_cast<Eigen::Index>(4 * lights.size() + p)] = 1.0;
      row[n_unknowns - 1] = (log_i(3, 1e-4) - log_i(3, -1e-4)) / 2e-4;
      information += row * row.transpose() / (0.005 * 0.005);
    }
  }
  // Gauge: the mean of the power, as it moves with ln e.
  Eigen::VectorXd gauge = Eigen::VectorXd::Zero(n_unknowns);
  double total = 0.0;
  for (const NearLight& light : lights) {
    total += light.power[0];
  }
  for (std::size_t k = 0; k < lights.size(); ++k) {
    gauge[static_cast<Eigen::Index>(4 * k) + 3] = lights[k].power[0] / total;
  }
  information += 1e8 * gauge * gauge.transpose();
  const Eigen::MatrixXd covariance =
      information.ldlt().solve(Eigen::MatrixXd::Identity(n_unknowns, n_unknowns));
  {
    const LightBounds bounds = free_light_bounds(s, lights, albedo);
    for (std::size_t k = 0; k < lights.size(); ++k) {
      const auto at = static_cast<Eigen::Index>(4 * k);
      const Eigen::Matrix3d truth = covariance.block<3, 3>(at, at);
      EXPECT_LT((bounds.lights[k].position_mm2 - truth).norm(), 2e-3 * truth.norm());
      EXPECT_NEAR(bounds.lights[k].power, std::sqrt(covariance(at + 3, at + 3)),
                  2e-3 * bounds.lights[k].power);
    }
    EXPECT_NEAR(bounds.mu, std::sqrt(covariance(n_unknowns - 1, n_unknowns - 1)),
                2e-3 * bounds.mu);
  }
}

TEST(LightBounds, OfModesAreThoseOfTheWholeSystem) {
  const std::vector<NearLight> lights = dome(12, 250.0, 4);
  TargetSamples s = simulate_target(lights, small_target(26));
  for (std::size_t i = 0; i < s.is_used.size(); i += 5) {
    s.is_used[i] = 0;  // a fifth is masked here and there
  }
  const std::vector<double> albedo(s.n_points(), 1.0);
  const LightBounds exact = free_light_bounds(s, lights, albedo, {.coupling = Coupling::dense});
  const LightBounds modes = free_light_bounds(s, lights, albedo, {.coupling = Coupling::modes});
  for (std::size_t k = 0; k < lights.size(); ++k) {
    EXPECT_NEAR(modes.lights[k].position_mm2.trace(), exact.lights[k].position_mm2.trace(),
                0.1 * exact.lights[k].position_mm2.trace());
  }
}

TEST(FreeLights, AreFoundToTheirBound) {
  const std::vector<NearLight> lights = dome(30, 250.0, 6);
  double error = 0.0;
  double bound = 0.0;
  // Errors of one capture go together (the exponent, the albedo): several captures.
  for (std::uint64_t seed = 1; seed <= 8; ++seed) {
    SimulatedTarget target = small_target(16);
    target.seed = seed;
    const TargetSamples s = simulate_target(lights, target);
    const LightCalibration found = calibrate_free_lights(s, paper_start(s, 1.0));
    ASSERT_TRUE(found.is_usable()) << found.brief_report();
    EXPECT_NEAR(found.reduced_chi2, 1.0, 0.07);
    EXPECT_NEAR(found.mu, 1.0, 4.0 * found.mu_sigma);
    double mean_power = 0.0;
    for (std::size_t k = 0; k < lights.size(); ++k) {
      const CalibratedLight& light = found.lights[k];
      EXPECT_EQ(light.finding, LightFinding::good) << k;
      EXPECT_EQ(light.counts.used, 256);
      error += (light.light.position_mm - lights[k].position_mm).squaredNorm();
      bound += light.sigma.position_mm2.trace();
      mean_power += light.light.power[0] / 30.0;
    }
    EXPECT_NEAR(mean_power, 1.0, 1e-12);
  }
  EXPECT_LT(std::sqrt(error / bound), 1.25);
  EXPECT_GT(std::sqrt(error / bound), 0.75);
}

TEST(FreeLights, InThreeColoursTakeAPowerEach) {
  const std::vector<NearLight> lights = dome(16, 250.0, 7);
  SimulatedTarget target = small_target();
  target.n_channels = 3;
  const TargetSamples s = simulate_target(lights, target);
  const LightCalibration found = calibrate_free_lights(s, paper_start(s, 1.0));
  ASSERT_TRUE(found.is_usable()) << found.brief_report();
  EXPECT_NEAR(found.reduced_chi2, 1.0, 0.05);
  Vector3d mean = Vector3d::Zero();
  for (const NearLight& light : lights) {
    mean += light.power / 16.0;
  }
  double error = 0.0;
  double bound = 0.0;
  for (std::size_t k = 0; k < lights.size(); ++k) {
    error += (found.lights[k].light.position_mm - lights[k].position_mm).squaredNorm();
    bound += found.lights[k].sigma.position_mm2.trace();
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(found.lights[k].light.power[c], lights[k].power[c] / mean[c],
                  6.0 * found.lights[k].sigma.power);
    }
  }
  EXPECT_LT(std::sqrt(error / bound), 1.4);  // 48 numbers
}

TEST(FreeLights, ThePaperModeIsWrongUnderALobeAndSaysSo) {
  const std::vector<NearLight> lights = dome(30, 250.0, 6);
  const TargetSamples s = simulate_target(lights, small_target());
  CalibrationOptions options;
  options.lobe = Lobe::paper;
  options.outlier_fraction = 0.0;
  const LightCalibration found = calibrate_free_lights(s, paper_start(s, 1.0), options);
  EXPECT_EQ(found.mu, 0.0);
  EXPECT_GT(furthest(found, lights), 20.0);
  EXPECT_GT(found.reduced_chi2, 1.5);
}

TEST(FreeLights, ShadowsSaturationAndDarkSamplesAreLeftOutAndCounted) {
  const std::vector<NearLight> lights = dome(30, 250.0, 6);
  TargetSamples s = simulate_target(lights, small_target());
  const std::size_t n = s.n_points();
  for (std::size_t p = 0; p < 100; ++p) {
    s.intensity[5 * n + p] *= 0.2F;  // a shadow over light 5
    s.intensity[6 * n + p] *= 3.0F;  // a highlight
  }
  for (std::size_t p = 200; p < 230; ++p) {
    s.intensity[7 * n + p] = 1.0F;  // white
    s.intensity[8 * n + p] = 0.0F;  // black
  }
  for (std::size_t k = 0; k < lights.size(); ++k) {
    s.intensity[k * n + 300] = 0.0F;  // a point that no light reaches: a black spot
    s.is_used[k * n + 301] = 0;
  }
  const LightCalibration found = calibrate_free_lights(s, paper_start(s, 1.0));
  ASSERT_TRUE(found.is_usable()) << found.brief_report();
  EXPECT_EQ(found.lights[5].counts.shadowed, 100);
  EXPECT_EQ(found.lights[6].counts.outlying, 100);
  EXPECT_EQ(found.lights[7].counts.saturated, 30);
  EXPECT_EQ(found.lights[8].counts.dark, 31);
  EXPECT_EQ(found.lights[9].counts.by_caller, 1);
  EXPECT_EQ(found.lights[9].counts.used, 574);
  EXPECT_EQ(found.albedo[300], 0.0);
  EXPECT_NEAR(found.reduced_chi2, 1.0, 0.05);
  for (std::size_t k = 0; k < lights.size(); ++k) {
    const Vector3d e = found.lights[k].light.position_mm - lights[k].position_mm;
    EXPECT_LT(e.dot(found.lights[k].sigma.position_mm2.ldlt().solve(e)), 30.0) << k;
  }
}

TEST(FreeLights, OfSixteenBitsCutAtWhite) {
  const std::vector<NearLight> lights = dome(20, 250.0, 8);
  SimulatedTarget target = small_target();
  target.bits = 16;
  const TargetSamples clean = simulate_target(lights, target);
  float brightest = 0.0F;
  for (const float value : clean.intensity) {
    brightest = std::max(brightest, value);
  }
  target.saturation = 0.7 * static_cast<double>(brightest);
  const TargetSamples s = simulate_target(lights, target);
  CalibrationOptions options;
  options.mask.saturation = 0.999999 * target.saturation;
  const LightCalibration found = calibrate_free_lights(s, paper_start(s, 1.0), options);
  ASSERT_TRUE(found.is_usable()) << found.brief_report();
  std::int64_t saturated = 0;
  for (std::size_t k = 0; k < lights.size(); ++k) {
    saturated += found.lights[k].counts.saturated;
    const Vector3d e = found.lights[k].light.position_mm - lights[k].position_mm;
    EXPECT_LT(e.dot(found.lights[k].sigma.position_mm2.ldlt().solve(e)), 25.0) << k;
  }
  EXPECT_GT(saturated, 100);
}

// ---- extremes ----

TEST(FreeLightExtremes, AThousandthOfATargetAwayIsFoundOrSaidToBeWeak) {
  std::vector<NearLight> lights = dome(10, 250.0, 11);
  lights[4].position_mm = {3.0, 2.0, 0.2};
  lights[4].power *= 1e-3;
  const TargetSamples s = simulate_target(lights, small_target());
  const LightCalibration found = calibrate_free_lights(s, paper_start(s, 1.0));
  // Most of what it lights is below the dark limit of its one bright point: few samples.
  EXPECT_LT(found.lights[4].counts.used, 576);
  const double apart = (found.lights[4].light.position_mm - lights[4].position_mm).norm();
  EXPECT_TRUE(found.lights[4].finding != LightFinding::good || apart < 1.0)
      << apart << " " << found.brief_report();
}

// ---- rigid array ----

RigidArray rigid(std::span<const NearLight> lights, const Eigen::Isometry3d& world_from_array) {
  RigidArray array;
  for (const NearLight& light : lights) {
    array.positions_mm.push_back(world_from_array.inverse() * light.position_mm);
    array.axes.emplace_back(world_from_array.linear().transpose() * light.axis);
  }
  return array;
}

TEST(RigidArray, ItsPoseIsFoundToTheBound) {
  const std::vector<NearLight> flat = array_lights(8, 8, 60.0, 0.0, 1.0, 0.3, 4);
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translate(Vector3d(20.0, -15.0, 300.0));
  pose.rotate(Eigen::AngleAxisd(0.1, Vector3d(1.0, 2.0, 0.5).normalized()));
  const RigidArray array = rigid(flat, Eigen::Isometry3d::Identity());
  std::vector<NearLight> lights = array_at(array, pose, 1.0);
  for (std::size_t k = 0; k < lights.size(); ++k) {
    lights[k].power = flat[k].power;
  }
  const TargetSamples s = simulate_target(lights, small_target());
  Eigen::Isometry3d start = Eigen::Isometry3d::Identity();
  start.translate(Vector3d(0.0, 0.0, 340.0));
  const LightCalibration found = calibrate_rigid_array(s, array, start);
  ASSERT_TRUE(found.is_usable()) << found.brief_report();
  ASSERT_TRUE(found.world_from_array.has_value());
  EXPECT_NEAR(found.reduced_chi2, 1.0, 0.05);
  Eigen::Matrix<double, 6, 1> e;
  const Eigen::AngleAxisd turn(found.world_from_array->linear() * pose.linear().transpose());
  e.head<3>() = turn.angle() * turn.axis();
  e.tail<3>() = found.world_from_array->translation() - pose.translation();
  // chi^2 with 6 degrees of freedom: 22.5 in one case of a thousand.
  EXPECT_LT(e.dot(found.pose_sigma->covariance.ldlt().solve(e)), 22.5);
  EXPECT_LT(e.tail<3>().norm(), 0.5);
  EXPECT_NEAR(found.mu, 1.0, 4.0 * found.mu_sigma);
}

TEST(RigidArray, BoundIsThatOfTheLikelihoodsCurvature) {
  // Ten seeds: the mean of e^T C^-1 e over the pose is 6.
  const std::vector<NearLight> lights = array_lights(4, 4, 100.0, 250.0, 1.0, 0.3, 4);
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translate(Vector3d(0.0, 0.0, 250.0));
  const RigidArray array = rigid(lights, pose);
  double sum = 0.0;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    SimulatedTarget target = small_target(16);
    target.seed = seed;
    const TargetSamples s = simulate_target(lights, target);
    CalibrationOptions options;
    options.outlier_fraction = 0.0;
    const LightCalibration found = calibrate_rigid_array(s, array, pose, options);
    Eigen::Matrix<double, 6, 1> e;
    const Eigen::AngleAxisd turn(found.world_from_array->linear());
    e.head<3>() = turn.angle() * turn.axis();
    e.tail<3>() = found.world_from_array->translation() - pose.translation();
    sum += e.dot(found.pose_sigma->covariance.ldlt().solve(e));
  }
  EXPECT_LT(sum / 10.0, 11.0);  // 60 degrees of freedom: 1e-4 quantile 103
  EXPECT_GT(sum / 10.0, 3.0);
}

TEST(RigidArray, BelowTheTargetIsRefused) {
  const std::vector<NearLight> lights = array_lights(4, 4, 30.0, 250.0, 1.0, 0.3, 4);
  const TargetSamples s = simulate_target(lights, small_target(8));
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translate(Vector3d(0.0, 0.0, 250.0));
  EXPECT_THROW(
      (void)calibrate_rigid_array(s, rigid(lights, pose), Eigen::Isometry3d::Identity()),
      Error);
}

TEST(NearLeds, EightRealPositionsAreFoundToTheirBound) {
  const std::filesystem::path file = "../shared/data/near_leds/light.mat";
  if (!std::filesystem::exists(file)) {
    GTEST_SKIP() << file << " is absent";
  }
  const std::vector<NearLight> lights = read_near_leds(file, 800.0);
  SimulatedTarget target = small_target(32);
  target.n_channels = 3;
  const TargetSamples s = simulate_target(lights, target);
  std::vector<Vector3d> axes;
  for (const NearLight& light : lights) {
    axes.push_back(light.axis);
  }
  const LightCalibration found =
      calibrate_free_lights(s, start_along_axes(s, axes, 400.0, 1.0));
  ASSERT_TRUE(found.is_usable()) << found.brief_report();
  for (std::size_t k = 0; k < lights.size(); ++k) {
    const Vector3d e = found.lights[k].light.position_mm - lights[k].position_mm;
    EXPECT_LT(e.dot(found.lights[k].sigma.position_mm2.ldlt().solve(e)), 25.0) << k;
  }
}

}  // namespace
}  // namespace haarlight::relight
