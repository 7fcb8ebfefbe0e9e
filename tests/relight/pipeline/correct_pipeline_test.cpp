// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/correct_pipeline.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/session/light_file.h"
#include "tests/relight/pipeline/made_capture.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using testing::PictureSize;

constexpr PictureSize kSize{10, 8};
constexpr double kWidthMm = 50.0;
const std::vector<Vector3d> kPositions = {{0.0, 0.0, 80.0}, {30.0, 0.0, 100.0}};
// Pictures and maps are 32-bit floats.
constexpr double kFloat = 1e-6;

/// Where a pixel's middle lies on the plane z = 0, mm: x right, y up, the picture's middle at
/// 0.
Vector3d point_of(int y, int x) {
  const double mm_per_pixel = kWidthMm / kSize.width;
  return {mm_per_pixel * (x + 0.5 - 0.5 * kSize.width),
          mm_per_pixel * (0.5 * kSize.height - y - 0.5), 0.0};
}

/// Of an isotropic light on the plane: cos / distance^2 = height / distance^3.
double stencil(const Vector3d& light, const Vector3d& point) {
  return light.z() / std::pow((light - point).norm(), 3.0);
}

class CorrectPipeline : public ::testing::Test {
 protected:
  CorrectPipeline() {
    testing::write_session(folder_ / "plane.session", kPositions,
                           session::LightCoordinates::positions, kSize,
                           [](const Vector3d& light, int y, int x) {
                             return 3000.0 * stencil(light, point_of(y, x));
                           });
    options_.session = folder_ / "plane.session";
    options_.out = folder_ / "even";
    options_.width_mm = kWidthMm;
  }

  testing::TemporaryFolder folder_;
  CorrectOptions options_;
};

TEST_F(CorrectPipeline, TheWeakestCornerIsThatOfTheInverseCube) {
  const CorrectSummary summary = correct_fall_off(options_);
  double least = 1.0;
  for (const Vector3d& light : kPositions) {
    for (int y = 0; y < kSize.height; ++y) {
      for (int x = 0; x < kSize.width; ++x) {
        least =
            std::min(least, stencil(light, point_of(y, x)) / stencil(light, Vector3d::Zero()));
      }
    }
  }
  EXPECT_EQ(summary.n_lights, 2);
  EXPECT_NEAR(summary.least_fall_off, least, kFloat);
}

TEST_F(CorrectPipeline, APlaneComesOutEvenAndAlikeUnderAllLights) {
  (void)correct_fall_off(options_);
  const Image<float> first = read_linear_image(options_.out / "light_0000.exr");
  const auto middle = double{first(0, 0, 0)};
  for (const char* name : {"light_0000.exr", "light_0001.exr"}) {
    const Image<float> even = read_linear_image(options_.out / name);
    for (const float value : even.pixels()) {
      EXPECT_NEAR(double{value}, middle, 4.0 * kFloat * middle);
    }
  }
}

TEST_F(CorrectPipeline, TheLightsAreFarAfterwards) {
  const CorrectSummary summary = correct_fall_off(options_);
  const session::LightList list = session::read_light_file(options_.out / "lights.lp");
  ASSERT_EQ(list.lights.size(), kPositions.size());
  std::uint64_t bytes = 0;
  for (std::size_t k = 0; k < kPositions.size(); ++k) {
    EXPECT_LT((list.lights[k].coordinates - kPositions[k].normalized()).norm(), kFloat);
    bytes += std::filesystem::file_size(options_.out / list.lights[k].name) +
             std::filesystem::file_size(options_.out / "fall-off" / list.lights[k].name);
  }
  EXPECT_EQ(summary.bytes, bytes);
}

TEST_F(CorrectPipeline, AFolderThatIsThereAndLightsWithoutPositionsAreRefused) {
  std::filesystem::create_directories(options_.out);
  EXPECT_THROW((void)correct_fall_off(options_), Error);
  options_.out = folder_ / "other";
  testing::write_session(folder_ / "far.session", {Vector3d::UnitZ(), {0.6, 0.0, 0.8}},
                         session::LightCoordinates::directions, kSize,
                         [](const Vector3d& light, int /*y*/, int x) { return light.z() + x; });
  options_.session = folder_ / "far.session";
  EXPECT_THROW((void)correct_fall_off(options_), Error);
  EXPECT_FALSE(std::filesystem::exists(options_.out));
}

}  // namespace
}  // namespace haarlight::relight
