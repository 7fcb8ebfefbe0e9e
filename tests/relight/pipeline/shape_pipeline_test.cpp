// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/shape/shape_pipeline.h"

#include <algorithm>
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "relight/pipeline/shape/shape_report.h"
#include "tests/relight/pipeline/made_capture.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using testing::PictureSize;

constexpr int kLights = 16;
constexpr PictureSize kSize{12, 9};
constexpr double kAlbedo = 0.5;
// A plane that every light reaches: steepest light 27 degrees off it, normal 14 off the view.
const Vector3d kNormal = Vector3d(0.2, -0.15, 1.0).normalized();
// Pictures are 32-bit floats: a normal's component is known to some 1e-7, its turn to 1e-5 rad.
constexpr double kFloatTurn = 1e-5;

class ShapePipeline : public ::testing::Test {
 protected:
  ShapePipeline() {
    testing::write_session(folder_ / "plane.session", testing::spiral_directions(kLights, 0.6),
                           session::LightCoordinates::directions, kSize,
                           [](const Vector3d& light, int /*y*/, int /*x*/) {
                             return kAlbedo * kNormal.dot(light);
                           });
    options_.input = folder_ / "plane.session";
    options_.out = folder_ / "plane.shape";
    options_.method = ShapeMethod::least_squares;
    options_.light = ShapeLight::far;
    options_.mask = MaskChoice::every;
  }

  testing::TemporaryFolder folder_;
  ShapePipelineOptions options_;
};

TEST_F(ShapePipeline, APlanesNormalAlbedoAndHeightsAreFound) {
  const ShapeSummary summary = recover_capture_shape(options_);
  const SurfaceEstimate& surface = summary.shape.surface;
  EXPECT_EQ(surface.n_in(PixelState::good), kSize.width * kSize.height);
  for (int y = 0; y < kSize.height; ++y) {
    for (int x = 0; x < kSize.width; ++x) {
      for (int c = 0; c < 3; ++c) {
        EXPECT_NEAR(double{surface.normal(y, x, c)}, kNormal[c], kFloatTurn);
      }
      EXPECT_NEAR(double{surface.albedo(y, x)}, kAlbedo, kFloatTurn);
    }
  }
  // Of z = -(n_x x + n_y y) / n_z over the pixels' middles, in pixel widths.
  const double range =
      (std::abs(kNormal.x()) * (kSize.width - 1) + std::abs(kNormal.y()) * (kSize.height - 1)) /
      kNormal.z();
  EXPECT_NEAR(summary.shape.bow_mm, range, kFloatTurn * (kSize.width + kSize.height));
  EXPECT_FALSE(summary.has_scale);
  EXPECT_FALSE(summary.are_near);
  EXPECT_TRUE(summary.is_measured);
  EXPECT_TRUE(summary.is_usable());
  EXPECT_EQ(summary.method, "least-squares");
  EXPECT_EQ(summary.mask_by, "every pixel");
  EXPECT_EQ(summary.mask.n_object, kSize.width * kSize.height);
  // Nothing contradicts the plane: the least that is ever stated, half a degree.
  EXPECT_FLOAT_EQ(static_cast<float>(sigma_below(summary, 0.9)), 0.5F);
}

TEST_F(ShapePipeline, AWidthGivesHeightsInMillimetres) {
  options_.width_mm = 24.0;
  const double mm_per_pixel = options_.width_mm / kSize.width;
  const ShapeSummary summary = recover_capture_shape(options_);
  const double range =
      (std::abs(kNormal.x()) * (kSize.width - 1) + std::abs(kNormal.y()) * (kSize.height - 1)) /
      kNormal.z() * mm_per_pixel;
  EXPECT_TRUE(summary.has_scale);
  EXPECT_NEAR(summary.shape.bow_mm, range, kFloatTurn * options_.width_mm * 2.0);
}

TEST_F(ShapePipeline, TheFilesHoldWhatTheSummarySays) {
  options_.writes_obj = false;
  const ShapeSummary summary = recover_capture_shape(options_);
  const Image<float> normals = read_linear_image(options_.out / "normals.exr");
  for (int c = 0; c < 3; ++c) {
    EXPECT_NEAR(double{normals(3, 4, c)}, kNormal[c], kFloatTurn);
  }
  std::uint64_t bytes = 0;
  for (const auto& file : std::filesystem::directory_iterator(options_.out)) {
    bytes += file.file_size();
  }
  EXPECT_EQ(summary.bytes, bytes);
  EXPECT_TRUE(std::filesystem::exists(options_.out / "mesh.ply"));
  EXPECT_FALSE(std::filesystem::exists(options_.out / "mesh.obj"));
}

TEST_F(ShapePipeline, AMaskLeavesOutWhatIsBlack) {
  Image<float> mask(kSize.height, kSize.width, 1);
  for (int y = 2; y < 7; ++y) {
    for (int x = 3; x < 9; ++x) {
      mask(y, x) = 1.0F;
    }
  }
  write_image(folder_ / "mask.png", mask.view());
  options_.mask = MaskChoice::picture;
  options_.mask_picture = folder_ / "mask.png";
  const ShapeSummary summary = recover_capture_shape(options_);
  EXPECT_EQ(summary.mask_by, "given");
  EXPECT_EQ(summary.shape.surface.n_in(PixelState::good), 5 * 6);
  EXPECT_EQ(summary.shape.surface.n_in(PixelState::masked), kSize.width * kSize.height - 30);
}

TEST_F(ShapePipeline, PartsThatDoNotTouchAreCountedAndWarnedOf) {
  Image<float> mask(kSize.height, kSize.width, 1);
  for (int y = 1; y < 8; ++y) {
    for (int x = 1; x < 11; ++x) {
      mask(y, x) = x < 4 || x > 7 ? 1.0F : 0.0F;
    }
  }
  write_image(folder_ / "mask.png", mask.view());
  options_.mask = MaskChoice::picture;
  options_.mask_picture = folder_ / "mask.png";
  const ShapeSummary summary = recover_capture_shape(options_);
  ASSERT_EQ(summary.shape.parts.size(), 2U);
  EXPECT_EQ(summary.shape.parts[0].n_pixels, 7 * 3);
  EXPECT_EQ(summary.shape.parts[1].n_pixels, 7 * 3);
  const std::vector<std::string> warnings = shape_warnings(summary);
  ASSERT_FALSE(warnings.empty());
  EXPECT_THAT(warnings.front(), ::testing::HasSubstr("2 parts do not touch (21, 21 pixels)"));
}

TEST_F(ShapePipeline, WhatCannotBeIsRefusedBeforeAnythingIsWritten) {
  options_.preview = Vector3d::Zero();
  EXPECT_THROW((void)recover_capture_shape(options_), Error);
  options_.preview = Vector3d::UnitZ();
  options_.light = ShapeLight::near;
  EXPECT_THROW((void)recover_capture_shape(options_), Error);
  options_.method = ShapeMethod::ptm;
  EXPECT_THROW((void)recover_capture_shape(options_), Error);
  EXPECT_FALSE(std::filesystem::exists(options_.out));
}

TEST_F(ShapePipeline, AHullIsForTheSessionOfARig) {
  options_.hull = folder_ / "a.hlb.hull";
  const auto refusal = [&] {
    try {
      (void)recover_capture_shape(options_);
    } catch (const Error& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_THAT(refusal(), ::testing::HasSubstr("no rig"));
  options_.input = folder_ / "plane.ptm";
  write_file_atomically(options_.input, std::string_view("PTM_1.2\n"));
  EXPECT_THAT(refusal(), ::testing::HasSubstr("a session's pictures"));
  EXPECT_FALSE(std::filesystem::exists(options_.out));
}

}  // namespace
}  // namespace haarlight::relight
