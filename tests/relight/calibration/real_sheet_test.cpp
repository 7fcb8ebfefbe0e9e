// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <limits>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/random.h"
#include "relight/calibration/near_calibration.h"
#include "relight/calibration/shared_terms.h"
#include "tests/relight/calibration/made_sheet.h"

/// @file
/// LEDs with a size, paper with a tooth, a sheet that bends: what the model of near lights
/// holds beside points over an ideal plane, and whether the stated uncertainties stay true. The
/// whole table: bench/relight/near_model_errors.cpp.

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

/// The stencil's mean over the emitter from 64 x 64 pieces.
double integrated(const NearLight& light, const Vector3d& point) {
  constexpr int kPieces = 64;
  double sum = 0.0;
  NearLight piece = light;
  piece.emitter_mm.setZero();
  for (int i = 0; i < kPieces * kPieces; ++i) {
    const int row = i / kPieces;
    const int col = i % kPieces;
    const Eigen::Vector2d at((col + 0.5) / kPieces - 0.5, (row + 0.5) / kPieces - 0.5);
    piece.position_mm = light.position_mm + light.emitter_mm * at;
    sum += light_stencil(piece, point, Vector3d::UnitZ());
  }
  return sum / (kPieces * kPieces);
}

TEST(EmitterPoints, RemainderIsOfFourthOrderInEdgeOverDistance) {
  NearLight light;
  light.position_mm = {40.0, -70.0, 100.0};
  light.mu = 1.0;
  double last = 0.0;
  for (const double edge : {80.0, 40.0, 20.0}) {
    light.emitter_mm.setZero();
    light.emitter_mm(0, 0) = edge;
    light.emitter_mm(1, 1) = 0.5 * edge;
    double worst = 0.0;
    double as_point = 0.0;
    NearLight point = light;
    point.emitter_mm.setZero();
    for (const double x : {-60.0, 0.0, 55.0}) {
      const Vector3d p(x, 20.0, 0.0);
      const double truth = integrated(light, p);
      worst = std::max(worst, std::abs(light_stencil(light, p, Vector3d::UnitZ()) / truth - 1));
      as_point =
          std::max(as_point, std::abs(light_stencil(point, p, Vector3d::UnitZ()) / truth - 1));
    }
    // The 64 x 64 pieces themselves are good to (edge / 64 h)^2, some 1e-5.
    EXPECT_LT(worst, 0.05 * std::pow(edge / 100.0, 4) + 2e-5) << edge;
    EXPECT_GT(as_point, 10.0 * worst) << edge;
    last = worst;
  }
  EXPECT_LT(last, 1e-4);
}

TEST(SharedTerms, ColumnsAreTheDerivativesOfTheStencil) {
  MadeSheet made{.led_mm = 25.0, .side = 2, .samples = 5};
  const MadePictures pictures = make_pictures(made, 3);
  SheetPriors priors = matte_paper(true);
  for (const SheetTerm term : {SheetTerm::height, SheetTerm::tilt_x, SheetTerm::tilt_y}) {
    priors.sigma[term] = 1.0;
  }
  SheetValues at;
  at[SheetTerm::roughness] = 0.15;
  at[SheetTerm::sheen] = 0.04;
  NearLight light = pictures.lights[1];
  light.mu = 1.2;
  const std::uint8_t* used = pictures.samples.used(1);
  const SharedTerms shared(true, priors);
  const TargetColumns target(pictures.samples, at);
  const LightTerms terms = light_terms(target, light, used, shared.wanted(false));
  Eigen::MatrixXd columns(target.point.rows(), shared.size());
  shared.fill(target, terms, 1, columns);
  const auto log_h = [&](const NearLight& l, const SheetValues& values) -> Eigen::ArrayXd {
    return light_terms(TargetColumns(pictures.samples, values), l, used).h.log();
  };
  // mu, then the nine terms.
  constexpr double kStep = 1e-4;
  ASSERT_EQ(shared.size(), 10);
  for (Eigen::Index i = 0; i < 10; ++i) {
    NearLight up = light;
    NearLight down = light;
    SheetValues more = at;
    SheetValues less = at;
    if (i == 0) {
      up.mu += kStep;
      down.mu -= kStep;
    } else {
      more.of[static_cast<std::size_t>(i - 1)] += kStep;
      less.of[static_cast<std::size_t>(i - 1)] -= kStep;
    }
    const Eigen::ArrayXd numeric = (log_h(up, more) - log_h(down, less)) / (2.0 * kStep);
    const double size = columns.col(i).cwiseAbs().maxCoeff();
    // The direction to the camera is not followed as a point moves; a step ends at a kink of
    // the roughness only where one light and the camera stand equally steep.
    const double tolerance = i >= 3 ? 5e-3 : 1e-5;
    EXPECT_LT((columns.col(i).array() - numeric).abs().maxCoeff(), tolerance * size) << i;
  }
  for (int c = 0; c < 3; ++c) {
    NearLight up = light;
    NearLight down = light;
    up.position_mm[c] += 0.01;
    down.position_mm[c] -= 0.01;
    const Eigen::ArrayXd numeric = (log_h(up, at) - log_h(down, at)) / 0.02;
    EXPECT_LT((terms.position.col(c) - numeric).abs().maxCoeff(), 1e-6) << c;
  }
}

CalibrationOptions paper_options() {
  CalibrationOptions options;
  options.mask.saturation = 1e30;
  options.sheet = matte_paper(true);
  return options;
}

/// e' C^-1 e of the pose over its six dimensions.
double pose_error(const MadePictures& made, const LightCalibration& found) {
  Eigen::Matrix<double, 6, 1> e;
  const Eigen::AngleAxisd turn(found.world_from_array->linear() *
                               made.pose.linear().transpose());
  e.head<3>() = turn.angle() * turn.axis();
  e.tail<3>() = found.world_from_array->translation() - made.pose.translation();
  return e.dot(found.pose_sigma->covariance.ldlt().solve(e)) / 6.0;
}

/// e' C^-1 e of each position over its three dimensions, mean over the lights.
double positions_error(const MadePictures& made, const LightCalibration& found) {
  double sum = 0.0;
  for (std::size_t k = 0; k < made.lights.size(); ++k) {
    const Vector3d e = found.lights[k].light.position_mm - made.lights[k].position_mm;
    sum += e.dot(found.lights[k].sigma.position_mm2.ldlt().solve(e)) / 3.0;
  }
  return sum / static_cast<double>(made.lights.size());
}

TEST(RealSheet, AnEmittersSizeIsPartOfTheModel) {
  const MadeSheet sheet{.led_mm = 30.0, .side = 6, .samples = 16};
  double with = 0.0;
  double without = 0.0;
  constexpr int kSeeds = 3;
  for (std::uint64_t seed = 1; seed <= kSeeds; ++seed) {
    MadePictures made = make_pictures(sheet, seed);
    CalibrationOptions options = paper_options();
    options.sheet = {};
    const LightCalibration found =
        calibrate_rigid_array(made.samples, made.array, made.pose, options);
    EXPECT_FALSE(found.is_model_wrong()) << found.brief_report();
    with += pose_error(made, found);
    made.array.emitters_mm.clear();
    without +=
        pose_error(made, calibrate_rigid_array(made.samples, made.array, made.pose, options));
  }
  EXPECT_LT(with / kSeeds, 2.7);  // 18 degrees of freedom: 1e-4 quantile 48 of 18
  EXPECT_GT(without / kSeeds, 4.0);
}

TEST(RealSheet, StatedErrorsHoldOrTheModelIsSaidToBeWrong) {
  for (const MadeSheet& one : made_sheets()) {
    MadeSheet sheet = one;
    const bool is_lobe = sheet.gauss_deg > 0.0;
    if (!is_lobe) {  // which free lights can only tell with many samples
      sheet.side = 6;
      sheet.samples = 12;
    }
    CalibrationOptions options = paper_options();
    const double tilt = made_sheet::kHalf * std::tan(sheet.tilt_deg * std::numbers::pi / 180.0);
    options.sheet.sigma[SheetTerm::tilt_x] = tilt / std::numbers::sqrt2;
    options.sheet.sigma[SheetTerm::tilt_y] = tilt / std::numbers::sqrt2;
    const MadePictures made = make_pictures(sheet, 5);
    std::vector<NearLight> start = paper_start(made.samples, 1.0);
    for (NearLight& light : start) {
      light.emitter_mm = made.lights.front().emitter_mm;
    }
    const LightCalibration free = calibrate_free_lights(made.samples, start, options);
    if (!free.is_model_wrong()) {
      // One draw of a few shared numbers: three times their standard deviation.
      EXPECT_LT(positions_error(made, free), 9.0) << sheet.name << ": " << free.brief_report();
    }
    const LightCalibration rigid =
        calibrate_rigid_array(made.samples, made.array, made.pose, options);
    if (!rigid.is_model_wrong()) {
      // 6 degrees of freedom: 1e-4 quantile 27.9.
      EXPECT_LT(pose_error(made, rigid), 27.9 / 6.0)
          << sheet.name << ": " << rigid.brief_report();
    }
    const bool is_beyond = is_lobe || sheet.bow_mm > 0.0 || sheet.gloss_exponent > 20.0;
    EXPECT_EQ(rigid.is_model_wrong(), is_beyond) << sheet.name << ": " << rigid.brief_report();
  }
}

TEST(RealSheet, HonestPicturesPassTheTestOfTheModelAtItsRate) {
  const MadeSheet sheet{.side = 6, .samples = 12};
  CalibrationOptions options = paper_options();
  double sum = 0.0;
  double squares = 0.0;
  constexpr int kSeeds = 60;
  for (std::uint64_t seed = 100; seed < 100 + kSeeds; ++seed) {
    const MadePictures made = make_pictures(sheet, seed);
    const LightCalibration found =
        calibrate_rigid_array(made.samples, made.array, made.pose, options);
    ASSERT_TRUE(found.test.is_done);
    EXPECT_TRUE(found.test.is_passed()) << found.brief_report();
    sum += found.test.z;
    squares += found.test.z * found.test.z;
  }
  // A standard normal: mean 0 +- 0.13, variance 1 +- 0.18; four of these each.
  EXPECT_NEAR(sum / kSeeds, 0.0, 0.52);
  EXPECT_NEAR(squares / kSeeds, 1.0, 0.73);
}

TEST(RealSheet, TheTestDoesNotTakeTheNoisesWord) {
  // Twice the stated noise: the samples fit worse, but nothing smooth is in them.
  MadeSheet sheet{.side = 6, .samples = 12, .noise = 0.01};
  MadePictures made = make_pictures(sheet, 7);
  made.samples.noise.relative = 0.005;
  const LightCalibration found =
      calibrate_rigid_array(made.samples, made.array, made.pose, paper_options());
  EXPECT_GT(found.reduced_chi2, 3.0);
  EXPECT_FALSE(found.is_model_wrong()) << found.brief_report();
}

TEST(RealSheet, ThePlanesOwnErrorIsCarriedOn) {
  const MadeSheet sheet{.side = 6, .samples = 12};
  const MadePictures made = make_pictures(sheet, 9);
  CalibrationOptions options = paper_options();
  options.sheet.sigma[SheetTerm::height] = 0.5;
  const LightCalibration found =
      calibrate_rigid_array(made.samples, made.array, made.pose, options);
  // A sheet whose height is known to 0.5 mm cannot position anything better along z.
  EXPECT_GT(std::sqrt(found.pose_sigma->covariance(5, 5)), 0.45);
}

}  // namespace
}  // namespace haarlight::relight
