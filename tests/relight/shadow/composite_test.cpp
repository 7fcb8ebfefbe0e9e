// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shadow/composite.h"

#include <cmath>
#include <utility>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"

namespace haarlight::relight {
namespace {

TEST(CompareDrawn, LooksAtTheDrawnPixelsOnly) {
  Image<float> truth(2, 2, 3);
  for (float& value : truth.pixels()) {
    value = 1.0F;
  }
  Image<float> picture = truth;
  Image<std::uint8_t> drawn(2, 2, 1);
  drawn(0, 1) = 1;
  drawn(1, 0) = 1;
  picture(0, 0, 1) = 100.0F;  // not the object's
  EXPECT_EQ(compare_drawn(picture, truth, drawn).relative_l2, 0.0);
  picture(1, 0, 2) = 1.5F;  // one of six values
  const Achieved found = compare_drawn(picture, truth, drawn);
  EXPECT_NEAR(found.relative_l2, 0.5 / std::sqrt(6.0), 1e-12);
  EXPECT_NEAR(found.worst_pixel, 0.5, 1e-12);
}

TEST(CompareDrawn, WantsPicturesOfOneSize) {
  const Image<float> picture(2, 2, 3);
  const Image<std::uint8_t> drawn(2, 3, 1);
  EXPECT_THROW((void)compare_drawn(picture, picture, drawn), ContractViolation);
}

/// Looks along +x from the origin, 8 x 8 pixels, z up.
CameraModel looking_along_x() {
  CameraModel camera;
  camera.width = camera.height = 8;
  camera.fx = camera.fy = 8.0;
  camera.cx = camera.cy = 4.0;
  camera.world_from_cam =
      look_at(Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitZ());
  return camera;
}

TEST(DrawBackground, ShowsTheEnvironmentBesideTheSceneAndWhatIsDrawn) {
  // A sheet at x = 80 whose right border halves the pixels of column 4.
  render::Scene scene;
  scene.materials.push_back({"sheet", Eigen::Vector3d::Constant(0.5), 0.0, 1.0});
  scene.meshes.push_back(render::make_quad({80.0, 90.0, -90.0}, {80.0, -5.0, -90.0},
                                           {80.0, -5.0, 90.0}, {80.0, 90.0, 90.0}, 0));
  Image<float> sky(16, 32, 3);
  for (int y = 0; y < 16; ++y) {  // red above, blue below, green to the left of the middle
    for (int x = 0; x < 32; ++x) {
      sky(y, x, 0) = y < 8 ? 1.0F : 0.0F;
      sky(y, x, 1) = x < 16 ? 1.0F : 0.0F;
      sky(y, x, 2) = y < 8 ? 0.0F : 1.0F;
    }
  }
  const auto environment = render::Environment::from_picture(std::move(sky), "sky");
  Image<float> picture(8, 8, 3);
  for (float& value : picture.pixels()) {
    value = 0.25F;
  }
  Image<std::uint8_t> drawn(8, 8, 1);
  drawn(1, 6) = 1;
  const double fraction = draw_background(picture, environment, render::RayCaster(scene),
                                          looking_along_x(), drawn, 2, 0.0);
  EXPECT_NEAR(fraction, (3.5 * 8.0 - 1.0) / 64.0, 1e-12);
  for (int c = 0; c < 3; ++c) {
    EXPECT_EQ(picture(2, 3, c), 0.25F) << "the sheet";
    EXPECT_EQ(picture(1, 6, c), 0.25F) << "what is drawn";
  }
  // To the right of +x, u grows: not the green half.
  EXPECT_EQ(picture(0, 7, 0), 1.25F);
  EXPECT_EQ(picture(0, 7, 1), 0.25F);
  EXPECT_EQ(picture(0, 7, 2), 0.25F);
  EXPECT_EQ(picture(7, 7, 0), 0.25F);
  EXPECT_EQ(picture(7, 7, 2), 1.25F);
  EXPECT_EQ(picture(7, 4, 2), 0.75F) << "half of the pixel";
}

TEST(DrawBackground, OutOfFocusIsTheMeanOverADisc) {
  // White above the horizon, and the scene is behind the camera.
  render::Scene scene;
  scene.materials.push_back({"sheet", Eigen::Vector3d::Constant(0.5), 0.0, 1.0});
  scene.meshes.push_back(render::make_quad({-80.0, 1.0, 0.0}, {-80.0, 2.0, 0.0},
                                           {-80.0, 2.0, 1.0}, {-80.0, 1.0, 1.0}, 0));
  Image<float> sky(90, 180, 3);
  for (int i = 0; i < 45 * 180 * 3; ++i) {
    sky.pixels()[static_cast<std::size_t>(i)] = 1.0F;
  }
  const auto environment = render::Environment::from_picture(std::move(sky), "sky");
  CameraModel camera = looking_along_x();
  camera.fx = camera.fy = 4.0 / std::tan(20.0 * 3.14159265358979 / 180.0);
  Image<float> picture(8, 8, 3);
  const double radius = 10.0;
  EXPECT_NEAR(
      draw_background(picture, environment, render::RayCaster(scene), camera, {}, 1, radius),
      1.0, 1e-12);
  // The part of a disc above a line at distance d from its middle.
  const double below = std::atan(0.5 / camera.fy) * 180.0 / 3.14159265358979;
  const double t = below / radius;
  const double above = (std::acos(t) - t * std::sqrt(1.0 - t * t)) / 3.14159265358979;
  EXPECT_NEAR(picture(4, 4, 0), above, 0.03);
  EXPECT_NEAR(picture(3, 3, 1), 1.0 - above, 0.03);
  EXPECT_EQ(picture(0, 4, 2), 1.0F);
  EXPECT_EQ(picture(7, 4, 2), 0.0F);
}

TEST(SceneScale, IsTheRadianceOfThePlane) {
  // A grey plane of albedo 1/2 under an LED of 4 mm^2: rho A / (pi 1e6 g).
  EXPECT_NEAR(scene_scale(2.0, 1, 0.5, 4.0), 0.5 * 4.0 / (3.14159265358979 * 2e6), 1e-18);
}

}  // namespace
}  // namespace haarlight::relight
