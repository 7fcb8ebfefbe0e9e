// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/calibrate_pipeline.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/session/light_file.h"
#include "tests/relight/pipeline/made_capture.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using testing::PictureSize;

double degrees_between(const Vector3d& a, const Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) * 180.0 / std::numbers::pi;
}

// ---- one mirror ball, far camera ----

constexpr PictureSize kBallSize{96, 90};
constexpr double kRadius = 36.0;
const Vector2d kCentre(47.0, 44.0);

/// A mirror turns the view (0, 0, 1) into `light` where its normal halves the angle: there the
/// highlight is, a spot of 1.3 pixels.
double ball_pixel(const Vector3d& light, int y, int x) {
  constexpr double kSpot = 1.3;
  constexpr double kDark = 0.02;
  const Vector3d normal = (light + Vector3d::UnitZ()).normalized();
  const Vector2d at = kCentre + kRadius * Vector2d(normal.x(), -normal.y());
  const Vector2d off = Vector2d(x + 0.5, y + 0.5) - at;
  return kDark + std::exp(-0.5 * off.squaredNorm() / (kSpot * kSpot));
}

class BallCalibration : public ::testing::Test {
 protected:
  BallCalibration() {
    testing::write_capture(folder_ / "ball", lights_, kBallSize, ".exr", ball_pixel);
    std::filesystem::remove(folder_ / "ball/lights.lp");
    Image<float> mask(kBallSize.height, kBallSize.width, 1);
    for (int y = 0; y < mask.height(); ++y) {
      for (int x = 0; x < mask.width(); ++x) {
        mask(y, x) = (Vector2d(x + 0.5, y + 0.5) - kCentre).norm() < kRadius ? 1.0F : 0.0F;
      }
    }
    write_image(folder_ / "mask.png", mask.view());
    options_.input = folder_ / "ball";
    options_.out = folder_ / "ball.lights";
    options_.target = LightTarget::ball;
    options_.ball.masks = {folder_ / "mask.png"};
  }

  testing::TemporaryFolder folder_;
  std::vector<Vector3d> lights_ = testing::spiral_directions(8, 0.2);
  CalibratePipelineOptions options_;
};

TEST_F(BallCalibration, DirectionsAreTheMirrors) {
  const CalibrateSummary summary = calibrate_capture_lights(options_);
  EXPECT_EQ(summary.method, "ball");
  EXPECT_TRUE(summary.is_usable());
  ASSERT_EQ(summary.found.lights.size(), lights_.size());
  ASSERT_TRUE(summary.balls.has_value());
  ASSERT_EQ(summary.balls->balls.size(), 1U);
  // A drawn disc's outline is its pixels': half of one off at most, less in the mean.
  EXPECT_NEAR(summary.balls->balls[0].circle.radius, kRadius, 0.5);
  for (std::size_t k = 0; k < lights_.size(); ++k) {
    const FoundLight& light = summary.found.lights[k];
    ASSERT_TRUE(light.sigma_deg.has_value());
    // Half a pixel of the outline: a normal turns by 0.5 / (R cos), the light twice as far.
    EXPECT_LT(*light.sigma_deg, 3.0);
    EXPECT_LT(degrees_between(light.direction, lights_[k]), 3.0 * *light.sigma_deg);
  }
}

TEST_F(BallCalibration, TheListsHoldWhatTheSummarySays) {
  const CalibrateSummary summary = calibrate_capture_lights(options_);
  std::uint64_t bytes = 0;
  for (const char* name : {"lights.json", "lights.lp", "lights.csv", "balls.png"}) {
    bytes += std::filesystem::file_size(options_.out / name);
  }
  EXPECT_EQ(summary.bytes, bytes);
  const session::LightList list = session::read_light_file(options_.out / "lights.json");
  ASSERT_EQ(list.lights.size(), lights_.size());
  for (std::size_t k = 0; k < lights_.size(); ++k) {
    EXPECT_EQ(list.lights[k].name, summary.found.lights[k].name);
    EXPECT_LT((list.lights[k].coordinates - summary.found.lights[k].direction).norm(), 1e-9);
  }
  EXPECT_THAT(found_line(summary.found), ::testing::StartsWith("8 of 8 lights found"));
}

TEST_F(BallCalibration, WhatTheCameraWasTakenForIsTold) {
  std::vector<PipelineNote> told;
  options_.settings.tell = [&](const PipelineNote& note) { told.push_back(note); };
  const CalibrateSummary summary = calibrate_capture_lights(options_);
  EXPECT_EQ(summary.notes, told);
  ASSERT_EQ(told.size(), 2U);
  EXPECT_EQ(told[0].kind, NoteKind::result);
  EXPECT_THAT(told[0].text, ::testing::StartsWith("ball at ("));
  EXPECT_EQ(told[1].kind, NoteKind::warning);
}

TEST_F(BallCalibration, OptionsThatDoNotSufficeAreRefused) {
  options_.ball.radius_mm = {12.0};
  EXPECT_THROW((void)calibrate_capture_lights(options_), Error);  // one ball, no position
  options_.target = LightTarget::sheet;
  EXPECT_THROW((void)calibrate_capture_lights(options_), Error);  // a ball's option
  options_ = {};
  options_.input = folder_ / "ball";
  options_.out = folder_ / "ball.lights";
  EXPECT_THROW((void)calibrate_capture_lights(options_), Error);  // what do they show?
  EXPECT_FALSE(std::filesystem::exists(options_.out));
}

// ---- a flat sheet under near lights ----

constexpr PictureSize kSheetSize{64, 48};
constexpr double kSheetWidthMm = 250.0;
constexpr double kCameraMm = 740.0;
constexpr double kNoise = 1e-3;

/// Isotropic lights over Lambertian paper: height / distance^3, times the paper's pattern.
double sheet_pixel(const Vector3d& light, int y, int x) {
  const double mm = kSheetWidthMm / kSheetSize.width;
  const Vector3d point(mm * (x + 0.5 - 0.5 * kSheetSize.width),
                       mm * (0.5 * kSheetSize.height - y - 0.5), 0.0);
  const double paper = 0.8 + 0.02 * std::sin(0.7 * x) * std::cos(0.5 * y);
  const auto key = hash_key(static_cast<std::uint64_t>(1e3 * (light.x() + 1e3)),
                            static_cast<std::uint64_t>(y), static_cast<std::uint64_t>(x));
  const double noise = 2.0 * (static_cast<double>(key % 100003) / 100003.0) - 1.0;
  return 3e4 * paper * light.z() / std::pow((light - point).norm(), 3.0) *
         (1.0 + kNoise * noise);
}

TEST(SheetCalibration, PositionsOfFreeLightsAreFound) {
  const testing::TemporaryFolder folder;
  std::vector<Vector3d> positions;
  for (const Vector3d& direction : testing::spiral_directions(10, 0.5)) {
    positions.emplace_back(260.0 * direction);
  }
  testing::write_capture(folder / "paper", positions, kSheetSize, ".exr", sheet_pixel);
  std::filesystem::remove(folder / "paper/lights.lp");
  CalibratePipelineOptions options;
  options.input = folder / "paper";
  options.out = folder / "paper.lights";
  options.target = LightTarget::sheet;
  options.width_mm = kSheetWidthMm;
  options.camera_mm = kCameraMm;
  options.sheet.aim = Aim::everywhere;
  options.sheet.aim_deg = 0.0;
  options.sheet.lobe = Lobe::given;
  options.sheet.mu = 0.0;
  options.sheet.bow_mm = 0.0;
  options.sheet.tilt_deg = 0.0;
  options.sheet.samples = 24;
  const CalibrateSummary summary = calibrate_capture_lights(options);
  EXPECT_EQ(summary.method, "sheet");
  ASSERT_TRUE(summary.sheet.has_value() && summary.sheet->flat.has_value());
  ASSERT_EQ(summary.found.lights.size(), positions.size());
  EXPECT_TRUE(summary.is_usable());
  for (std::size_t k = 0; k < positions.size(); ++k) {
    ASSERT_TRUE(summary.found.lights[k].position_mm.has_value());
    ASSERT_TRUE(summary.found.lights[k].sigma_mm.has_value());
    const double sigma_mm = summary.found.lights[k].sigma_mm->norm();
    // 1e-3 of noise per pixel over 3000 pixels; roughness and sheen are unknowns besides.
    EXPECT_LT(sigma_mm, 0.5);
    EXPECT_LT((*summary.found.lights[k].position_mm - positions[k]).norm(), 3.0 * sigma_mm);
  }
}

}  // namespace
}  // namespace haarlight::relight
