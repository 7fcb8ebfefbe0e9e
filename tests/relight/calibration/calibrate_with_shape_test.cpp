// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/calibrate_with_shape.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Dense>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

/// Exact for a smooth surface: the polynomial of degree 5 whose slopes are nearest to those of
/// the normals; its mean height is 0.
std::vector<Vector3d> smooth_surface(const TargetSamples& s,
                                     std::span<const Vector3d> normals) {
  constexpr int kDegree = 5;
  constexpr int kTerms = (kDegree + 1) * (kDegree + 2) / 2 - 1;
  const auto n = static_cast<Eigen::Index>(s.n_points());
  Eigen::MatrixXd slopes(2 * n, kTerms);
  Eigen::MatrixXd values(n, kTerms);
  Eigen::VectorXd rhs(2 * n);
  for (Eigen::Index p = 0; p < n; ++p) {
    const auto at = static_cast<std::size_t>(p);
    const double x = s.points_mm[at].x() / 100.0;
    const double y = s.points_mm[at].y() / 100.0;
    int term = 0;
    for (int i = 0; i <= kDegree; ++i) {
      for (int j = 0; i + j <= kDegree; ++j) {
        if (i + j == 0) {
          continue;
        }
        values(p, term) = std::pow(x, i) * std::pow(y, j);
        slopes(2 * p, term) = i > 0 ? i * std::pow(x, i - 1) * std::pow(y, j) / 100.0 : 0.0;
        slopes(2 * p + 1, term) = j > 0 ? j * std::pow(x, i) * std::pow(y, j - 1) / 100.0 : 0.0;
        ++term;
      }
    }
    rhs[2 * p] = -normals[at].x() / normals[at].z();
    rhs[2 * p + 1] = -normals[at].y() / normals[at].z();
  }
  const Eigen::VectorXd c = slopes.householderQr().solve(rhs);
  Eigen::VectorXd z = values * c;
  z.array() -= z.mean();
  std::vector<Vector3d> points = s.points_mm;
  for (Eigen::Index p = 0; p < n; ++p) {
    points[static_cast<std::size_t>(p)].z() = z[p];
  }
  return points;
}

std::vector<NearLight> around(int n) {
  std::vector<NearLight> lights;
  for (int k = 0; k < n; ++k) {
    NearLight light;
    const double out = 260.0 * std::sqrt((k + 0.5) / n);
    light.position_mm = {out * std::cos(2.4 * k), out * std::sin(2.4 * k),
                         250.0 + 5.0 * (k % 7)};
    light.mu = 1.0;
    light.power.setConstant(0.8 +
                            0.4 * uniform_unit(hash_key(5, static_cast<std::uint64_t>(k))));
    lights.push_back(light);
  }
  return lights;
}

double rms_height_error(const std::vector<Vector3d>& found, const TargetSamples& truth) {
  double mean = 0.0;
  for (std::size_t p = 0; p < found.size(); ++p) {
    mean += (found[p].z() - truth.points_mm[p].z()) / static_cast<double>(found.size());
  }
  double sum = 0.0;
  for (std::size_t p = 0; p < found.size(); ++p) {
    sum += std::pow(found[p].z() - truth.points_mm[p].z() - mean, 2);
  }
  return std::sqrt(sum / static_cast<double>(found.size()));
}

TEST(SolveNormals, AreThoseOfTheSurface) {
  SimulatedTarget target;
  target.rows = target.cols = 12;
  target.noise = 0.0;
  target.height = [](double x, double y) { return 10.0 - 1e-3 * (x * x + 0.5 * y * y); };
  const std::vector<NearLight> lights = around(8);
  TargetSamples s = simulate_target(lights, target);
  s.noise.relative = 0.005;
  const std::vector<Vector3d> truth = s.normals;
  std::fill(s.normals.begin(), s.normals.end(), Vector3d::UnitZ());
  const PointNormals found = solve_normals(s, lights);
  EXPECT_EQ(found.n_unsolved, 0U);
  for (std::size_t p = 0; p < truth.size(); ++p) {
    EXPECT_LT((found.normals[p] - truth[p]).norm(), 1e-6);
    EXPECT_NEAR(found.albedo[p], 1.0, 1e-6);
  }
}

TEST(SolveNormals, OfLightsInOnePlaneAreRefusedWithTheUnknownDirection) {
  std::vector<NearLight> lights = around(6);
  for (std::size_t k = 0; k < lights.size(); ++k) {
    lights[k].position_mm = {4e6 * (static_cast<double>(k) - 2.5), 0.0, 1e7};  // far, in y = 0
  }
  SimulatedTarget target;
  target.rows = target.cols = 6;
  target.noise = 0.0;
  TargetSamples s = simulate_target(lights, target);
  s.noise = {.relative = 0.005};
  try {
    (void)solve_normals(s, lights);
    FAIL() << "not refused";
  } catch (const Error& error) {
    EXPECT_NE(error.problem().find("1.00, "), std::string::npos) << error.problem();
  }
}

TEST(Alternation, FindsACurvedTargetFromAFlatStart) {
  SimulatedTarget target;
  target.rows = target.cols = 20;
  target.noise = 0.001;
  target.height = [](double x, double y) {
    return 4.0 - 5e-4 * (x * x + y * y) + 2e-6 * x * x * y;
  };
  const std::vector<NearLight> lights = around(24);
  TargetSamples s = simulate_target(lights, target);
  const TargetSamples truth = s;
  for (std::size_t p = 0; p < s.n_points(); ++p) {
    s.points_mm[p].z() = 0.0;
    s.normals[p] = Vector3d::UnitZ();
  }
  const double flat = rms_height_error(s.points_mm, truth);
  AlternationOptions options;
  options.lights.lobe = Lobe::given;
  options.lights.outlier_fraction = 0.0;
  options.max_rounds = 40;
  std::vector<NearLight> start = paper_start(s, 1.0);
  const Alternation found = calibrate_with_shape(s, start, smooth_surface, options);
  std::string history;
  for (std::size_t i = 0; i < found.moves_mm.size(); ++i) {
    history += " " + std::to_string(found.moves_mm[i]) + "/" + std::to_string(found.chi2[i]);
  }
  const double bent = rms_height_error(found.points_mm, truth);
  RecordProperty("rms_height_error_mm", std::to_string(bent));
  EXPECT_GT(flat, 1.0);
  // The pictures are explained to their noise; a bend that the lights can hide is left.
  EXPECT_TRUE(found.has_converged) << history;
  EXPECT_GT(found.chi2.front(), 50.0) << history;
  EXPECT_LT(found.chi2.back(), 1.1) << history;
  EXPECT_LT(bent, 0.2 * flat) << history;
}

}  // namespace
}  // namespace haarlight::relight
