// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/light/light_weights.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numbers>

#include <Eigen/Geometry>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/render/light/environment_texels.h"

namespace haarlight::relight {
namespace {

constexpr double kPi = std::numbers::pi;

Rig top_rig(int n = 32) {
  Rig rig;
  rig.name = "top";
  rig.object_centre = {0.0, 0.0, 45.0};
  Face face;
  face.id = "top";
  face.centre = {0.0, 0.0, 900.0};
  face.rows = n;
  face.cols = n;
  face.pitch_mm = 960.0 / n;
  face.emitter_w_mm = face.emitter_h_mm = 0.93 * face.pitch_mm;
  rig.faces = {face};
  return rig;
}

/// Six faces of a cube of side 1800 about the origin: nothing is missing.
Rig cube_rig(int n = 4) {
  Rig rig;
  rig.name = "cube";
  for (int axis = 0; axis < 3; ++axis) {
    for (const double sign : {1.0, -1.0}) {
      Face face;
      face.id = std::to_string(axis) + (sign > 0 ? "+" : "-");
      face.centre = Eigen::Vector3d::Zero();
      face.centre[axis] = 900.0 * sign;
      face.u = Eigen::Vector3d::Unit((axis + 1) % 3);
      face.v = Eigen::Vector3d::Unit((axis + 2) % 3);
      face.emits = -sign * Eigen::Vector3d::Unit(axis);
      face.rows = face.cols = n;
      face.pitch_mm = 1800.0 / n;
      face.emitter_w_mm = face.emitter_h_mm = 0.9 * face.pitch_mm;
      rig.faces.push_back(face);
    }
  }
  return rig;
}

render::Environment random_environment(int width, int height, std::uint64_t seed,
                                       int channels = 3) {
  Image<float> image(height, width, channels);
  std::uint64_t i = 0;
  for (float& v : image.pixels()) {
    v = static_cast<float>(std::pow(uniform_unit(hash_key(seed, ++i)), 6.0) * 100.0);
  }
  return render::Environment::from_picture(std::move(image), "made");
}

render::Environment constant_environment(int width, int height) {
  Image<float> image(height, width, 1);
  std::fill(image.pixels().begin(), image.pixels().end(), 1.0F);
  return render::Environment::from_picture(std::move(image), "made");
}

/// Closed form: solid angle of the rectangle [0, a] x [0, b] at distance h, seen from above its
/// corner: atan(ab / (h sqrt(h^2 + a^2 + b^2))).
double corner_solid_angle(double a, double b, double h) {
  return std::atan2(a * b, h * std::sqrt(h * h + a * a + b * b));
}

TEST(SolidAngle, OctantAndTinySquareHaveTheirClosedForms) {
  const std::vector<Eigen::Vector3d> octant = {
      Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitY(), Eigen::Vector3d::UnitZ()};
  EXPECT_NEAR(render::solid_angle(octant), kPi / 2.0, 1e-15);
  const double s = 1e-6;
  const std::vector<Eigen::Vector3d> tiny = {{0, 0, 1}, {s, 0, 1}, {s, s, 1}, {0, s, 1}};
  EXPECT_NEAR(render::solid_angle(tiny) / corner_solid_angle(s, s, 1.0), 1.0, 1e-9);
}

TEST(RigWeights, CellsOfAConstantSkyAreTheirSolidAngles) {
  const Rig rig = top_rig();
  // The error of the chords: 1e-7 rad along a border of the cell, of 0.035 rad.
  for (const auto& [w, h] : {std::pair{64, 32}, {256, 128}, {60, 45}}) {
    const auto result = rig_weights(constant_environment(w, h), rig);
    double sum = 0.0;
    for (int row = 0; row < 32; ++row) {
      for (int col = 0; col < 32; ++col) {
        const double a0 = (col - 16) * 30.0;
        const double b0 = (row - 16) * 30.0;
        const double exact = corner_solid_angle(a0 + 30.0, b0 + 30.0, 855.0) -
                             corner_solid_angle(a0, b0 + 30.0, 855.0) -
                             corner_solid_angle(a0 + 30.0, b0, 855.0) +
                             corner_solid_angle(a0, b0, 855.0);
        EXPECT_NEAR(result.cell_solid_angle[row * 32 + col] / exact, 1.0, 1e-5);
        sum += exact;
      }
    }
    EXPECT_NEAR(result.cell_solid_angle.sum() / sum, 1.0, 1e-6);
    EXPECT_NEAR(result.missing_fraction, 1.0 - sum / (4.0 * kPi), 1e-7);
  }
}

TEST(RigWeights, EnergyIsConserved) {
  for (const auto& [w, h] : {std::pair{64, 32}, {40, 30}, {30, 40}, {48, 8}}) {
    for (const Rig& rig : {top_rig(), cube_rig()}) {
      const auto environment = random_environment(w, h, 7);
      const auto result = rig_weights(environment, rig);
      EXPECT_LE(result.conservation_error, 1e-12);
      // The total, by texel centres' areas alone.
      Eigen::Vector3d total = Eigen::Vector3d::Zero();
      const render::EnvironmentTexels texels(environment);
      for (int row = 0; row < texels.n_rows(); ++row) {
        texels.for_each(row, [&](const render::EnvironmentTexel& texel) {
          total += texel.solid_angle * texel.radiance;
        });
      }
      const Eigen::Vector3d cells = result.cell_radiance.colwise().sum().transpose();
      for (int c = 0; c < 3; ++c) {
        EXPECT_NEAR((cells[c] + result.missing[c]) / total[c], 1.0, 1e-6);
      }
    }
  }
}

TEST(RigWeights, ManyCellsHoldWhatOneCellOfTheWholeFaceHolds) {
  for (const auto& [w, h] : {std::pair{64, 32}, {40, 30}}) {
    const auto environment = random_environment(w, h, 19);
    const auto fine = rig_weights(environment, top_rig(32));
    const auto whole = rig_weights(environment, top_rig(1));
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(fine.cell_radiance.col(c).sum() / whole.cell_radiance(0, c), 1.0, 1e-9);
      EXPECT_NEAR(fine.missing[c] / whole.missing[c], 1.0, 1e-12);
    }
    EXPECT_NEAR(fine.cell_solid_angle.sum() / whole.cell_solid_angle[0], 1.0, 1e-9);
  }
}

TEST(RigWeights, ClosedCubeMissesNothing) {
  const auto result = rig_weights(random_environment(64, 32, 3), cube_rig());
  EXPECT_LE(result.missing_fraction, 1e-6);
  EXPECT_NEAR(result.cell_solid_angle.sum(), 4.0 * kPi, 1e-6);
}

TEST(RigWeights, MatchesPointSampling) {
  // 2000 x 2000 points over the face, each with the Jacobian h / r^3. A texel is some 175
  // points wide and its border misplaced by up to half a point: 0.3 % per texel of full
  // contrast.
  const Rig rig = top_rig(4);
  const auto environment = random_environment(64, 32, 11, 1);
  const auto result = rig_weights(environment, rig);
  Eigen::VectorXd sampled = Eigen::VectorXd::Zero(16);
  const int n = 2000;
  const double step = 960.0 / n;
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      const Eigen::Vector3d d(-480.0 + (i + 0.5) * step, -480.0 + (j + 0.5) * step, 855.0);
      const double r = d.norm();
      sampled[j / (n / 4) * 4 + i / (n / 4)] +=
          environment.radiance(d)[0] * 855.0 / (r * r * r) * step * step;
    }
  }
  for (int k = 0; k < 16; ++k) {
    EXPECT_NEAR(result.cell_radiance(k, 0) / sampled[k], 1.0, 4e-3) << k;
  }
}

TEST(RigWeights, OneHotTexelLightsTheCellsItCovers) {
  // Texel of 10^6 straight above: the four middle LEDs share it alike, whatever the rotation.
  Image<float> image(512, 1024, 1);
  for (int x = 0; x < 1024; ++x) {
    image(0, x) = 1e6F;
  }
  auto environment = render::Environment::from_picture(std::move(image), "made");
  environment.rotate(0.3);
  const auto result = rig_weights(environment, top_rig());
  const double each = result.total[0] / 4.0;
  for (const int k : {15 * 32 + 15, 15 * 32 + 16, 16 * 32 + 15, 16 * 32 + 16}) {
    EXPECT_NEAR(result.cell_radiance(k, 0) / each, 1.0, 1e-6);
  }
  EXPECT_LE(result.missing_fraction, 1e-9);
  EXPECT_TRUE(result.weights.allFinite());
}

TEST(RigWeights, BlackEnvironmentGivesNothing) {
  const auto result =
      rig_weights(render::Environment::from_picture(Image<float>(16, 32, 3), ""), top_rig());
  EXPECT_EQ(result.weights.cwiseAbs().maxCoeff(), 0.0);
  EXPECT_EQ(result.missing_fraction, 0.0);
  EXPECT_EQ(result.conservation_error, 0.0);
}

TEST(RigWeights, DriveReplacesTheSkyOnAFacingSurface) {
  // w_k G_k is the irradiance that the cell's piece of sky gives on a surface facing it.
  const Rig rig = top_rig();
  const auto result = rig_weights(constant_environment(256, 128), rig);
  for (const int k : {0, 495, 1023}) {
    const double g = facing_irradiance(light_element(rig, k), rig.object_centre);
    EXPECT_NEAR(result.weights(k, 0) * g, result.cell_radiance(k, 0), 1e-15);
    // Far away a square of area A turned by t gives A cos t / r^2.
    const LightElement light = light_element(rig, k);
    const Eigen::Vector3d to = light.centre - rig.object_centre;
    const double point = 27.9 * 27.9 * to.normalized().z() / to.squaredNorm();
    EXPECT_NEAR(g / point, 1.0, 2e-3);
  }
}

TEST(RigWeights, SameBitsWithOneTwoSevenThreads) {
  const auto environment = random_environment(128, 64, 5);
  Eigen::MatrixXd first;
  for (const int threads : {1, 2, 7}) {
    const ThreadLimit limit(threads);
    const auto result = rig_weights(environment, top_rig());
    if (first.size() == 0) {
      first = result.weights;
    }
    EXPECT_TRUE(result.weights == first) << threads;
  }
}

TEST(RigWeights, TwoFacesInOneDirectionAreRefused) {
  Rig rig = top_rig(4);
  rig.faces.push_back(rig.faces[0]);
  rig.faces[1].centre.z() = 1200.0;
  EXPECT_THROW((void)rig_weights(constant_environment(32, 16), rig), Error);
  // A face that shines away from the object is no source: its part is missing.
  Rig away = top_rig(4);
  away.faces[0].emits = Eigen::Vector3d::UnitZ();
  const auto result = rig_weights(constant_environment(32, 16), away);
  EXPECT_NEAR(result.missing_fraction, 1.0, 1e-12);
}

TEST(VoronoiWeights, SixAxesShareAConstantSkyAlike) {
  std::vector<Eigen::Vector3d> directions;
  for (int axis = 0; axis < 3; ++axis) {
    directions.emplace_back(Eigen::Vector3d::Unit(axis));
    directions.emplace_back(-Eigen::Vector3d::Unit(axis));
  }
  const auto result = voronoi_weights(constant_environment(64, 32), directions);
  for (int k = 0; k < 6; ++k) {
    EXPECT_NEAR(result.weights(k, 0), 4.0 * kPi / 6.0, 2e-6);
  }
}

RC_GTEST_PROP(VoronoiWeightsProperty, ConserveEnergy, (std::uint64_t seed)) {
  const int n = *rc::gen::inRange(1, 40);
  std::vector<Eigen::Vector3d> directions;
  for (int k = 0; k < n; ++k) {
    Eigen::Vector3d d;
    for (int axis = 0; axis < 3; ++axis) {
      d[axis] = standard_normal(
          hash_key(seed, static_cast<std::uint64_t>(k), static_cast<std::uint64_t>(axis)));
    }
    directions.push_back(d.normalized());
  }
  if (n > 3) {
    directions[1] = directions[0];  // two lights at one position share their cell
  }
  const auto result = voronoi_weights(random_environment(32, 16, seed), directions);
  RC_ASSERT(result.conservation_error <= 1e-12);
  RC_ASSERT(result.missing_fraction <= 1e-9);
  if (n > 3) {
    RC_ASSERT(std::abs(result.weights(0, 0) - result.weights(1, 0)) <= 1e-12 * result.total[0]);
  }
}

TEST(VoronoiWeights, TexelGoesToTheNearestLight) {
  const std::vector<Eigen::Vector3d> directions = {Eigen::Vector3d(1, 0, 1).normalized(),
                                                   Eigen::Vector3d(-1, 0, 1).normalized(),
                                                   Eigen::Vector3d(0, 1, 1).normalized()};
  Image<float> image(180, 360, 1);
  image(60, 180) = 1.0F;  // towards +x
  const auto result =
      voronoi_weights(render::Environment::from_picture(std::move(image), "made"), directions);
  EXPECT_GT(result.weights(0, 0), 0.0);
  EXPECT_EQ(result.weights(1, 0), 0.0);
  EXPECT_EQ(result.weights(2, 0), 0.0);
}

}  // namespace
}  // namespace haarlight::relight
