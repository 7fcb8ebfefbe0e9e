// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/light/near_light.h"

#include <cmath>

#include <gtest/gtest.h>

#include "core/json_value.h"
#include "haarlight/core/error.h"
#include "session/rig_session.h"
#include "session/transforms_file.h"

namespace haarlight::relight {
namespace {

TEST(NearLight, StencilIsTheClosedForm) {
  const NearLight above{{0.0, 0.0, 200.0}};
  EXPECT_DOUBLE_EQ(light_stencil(above, {0, 0, 0}, {0, 0, 1}), 1.0 / (200.0 * 200.0));
  // At 45 degrees: cos 45 / (2 h^2); a Lambertian lobe takes another cos 45.
  const double at45 = light_stencil(above, {200, 0, 0}, {0, 0, 1});
  EXPECT_NEAR(at45, std::sqrt(0.5) / (2.0 * 200.0 * 200.0), 1e-18);
  NearLight lambertian = above;
  lambertian.mu = 1.0;
  EXPECT_NEAR(light_stencil(lambertian, {200, 0, 0}, {0, 0, 1}), at45 * std::sqrt(0.5), 1e-18);
  EXPECT_EQ(light_stencil(above, {0, 0, 300}, {0, 0, 1}), 0.0);
  lambertian.axis = Eigen::Vector3d::UnitZ();
  EXPECT_EQ(light_stencil(lambertian, {0, 0, 0}, {0, 0, 1}), 0.0);
}

TEST(NearLight, OrthographicPixelsLieInTheirFrame) {
  const PixelPoints points = PixelPoints::orthographic(200, 100, 400.0);
  EXPECT_TRUE(points.at(100, 50).isZero());
  EXPECT_TRUE(points.at(0, 0).isApprox(Eigen::Vector3d(-200, 100, 0)));
  EXPECT_TRUE(points.at(199.5, 99.5).isApprox(Eigen::Vector3d(199, -99, 0)));
}

/// The origin stays in the middle of the whole picture.
TEST(NearLight, PixelsOfACropLieWhereTheyLayInTheWhole) {
  constexpr double kMmAPixel = 2.0;
  const PixelPoints whole = PixelPoints::orthographic(200, 100, 200 * kMmAPixel);
  const PixelPoints part =
      PixelPoints::orthographic(60, 40, 60 * kMmAPixel, session::FrameCrop{120, 7, 200, 100});
  for (const double x : {0.0, 0.5, 59.5}) {
    for (const double y : {0.0, 17.5, 40.0}) {
      EXPECT_TRUE(part.at(x, y).isApprox(whole.at(x + 120, y + 7), 1e-14)) << x << " " << y;
    }
  }
  EXPECT_DOUBLE_EQ(part.mm_per_pixel(), kMmAPixel);
}

/// What an EXR says of its light is what the transforms.json beside it says.
TEST(NearLight, LightsInThePictureAreThoseOfTheTransformsFile) {
  const Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/cube32.toml");
  session::SessionInfo info;
  session::describe_rig(rig, info);
  const std::vector<session::SessionLight> seen = lights_in_picture(rig, info.lights);
  std::vector<std::string> names;
  for (const session::SessionLight& light : info.lights) {
    names.push_back(light.name + ".exr");
  }
  const std::string text = session::format_transforms(rig.cameras.front().model,
                                                      rig.object_centre, info.lights, names);
  const session::LightList list = session::parse_transforms(
      JsonValue::parse(text, "transforms.json"), session::LightCoordinates::automatic);
  ASSERT_EQ(seen.size(), list.lights.size());
  for (std::size_t k = 0; k < seen.size(); ++k) {
    // Of hundreds of mm, two turns in double precision apart.
    ASSERT_LT((seen[k].coordinates - list.lights[k].coordinates).norm(), 1e-9) << k;
    ASSERT_TRUE(seen[k].lobe.has_value());
    ASSERT_NEAR(seen[k].lobe->axis.norm(), 1.0, 1e-12);
  }
}

TEST(NearLight, CameraPixelsLieOnThePlane) {
  CameraModel camera;
  camera.width = 640;
  camera.height = 480;
  camera.fx = camera.fy = 900.0;
  camera.cx = 320.0;
  camera.cy = 240.0;
  camera.world_from_cam = look_at({100, 50, 800}, {0, 0, 0}, {0, 1, 0});
  const PixelPoints points = PixelPoints::on_plane(camera, Eigen::Vector3d::UnitZ(), -20.0);
  for (const double x : {3.0, 320.0, 600.0}) {
    const Eigen::Vector3d at = points.at(x, 100.0);
    EXPECT_NEAR(at.z(), 20.0, 1e-9);
    const auto back = project(camera, at);
    ASSERT_TRUE(back.has_value());
    EXPECT_NEAR(back->x(), x, 1e-8);
    EXPECT_NEAR(back->y(), 100.0, 1e-8);
    EXPECT_TRUE(
        points.to_camera(x, 100.0).isApprox((camera.centre_world() - at).normalized(), 1e-9));
  }
  // The camera looks down: its own frame's z comes towards it.
  EXPECT_GT((points.picture_from_world() * points.to_camera(320, 240)).z(), 0.999999);
  EXPECT_GT((points.picture_from_world() * Eigen::Vector3d::UnitY()).y(), 0.9);
  EXPECT_NEAR(points.picture_from_world().determinant(), 1.0, 1e-12);
  EXPECT_THROW(PixelPoints::on_plane(camera, Eigen::Vector3d::UnitZ(), -2000.0), Error);
}

/// A step towards a light moves in the picture the way its direction says.
TEST(NearLight, PictureDirectionsAreAsTheCameraSeesThem) {
  const Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/cube32.toml");
  const CameraModel& camera = rig.cameras.front().model;
  const std::vector<Eigen::Vector3d> directions = picture_directions(rig);
  ASSERT_EQ(directions.size(), 1024U);
  const Eigen::Vector3d centre = rig.object_centre;
  const Eigen::Vector2d from = project(camera, centre).value();
  for (int k = 0; k < rig.n_lights(); k += 31) {
    const Eigen::Vector3d& d = directions[static_cast<std::size_t>(k)];
    EXPECT_NEAR(d.norm(), 1.0, 1e-12);
    const Eigen::Vector3d to_light = (light_element(rig, k).centre - centre).normalized();
    constexpr double kStepMm = 1e-3;
    const Eigen::Vector2d to = project(camera, centre + kStepMm * to_light).value();
    // The camera looks at the object's centre within some degrees, so a step along the view
    // shows by that angle.
    const Eigen::Vector2d seen = (to - from).cwiseProduct(Eigen::Vector2d(1.0, -1.0));
    const double pixels_a_mm = camera.fx / (camera.centre_world() - centre).norm();
    EXPECT_LT((seen / (kStepMm * pixels_a_mm) - d.head<2>()).norm(), 0.1) << k;
    EXPECT_GT(d.z(), -0.2);
  }
}

}  // namespace
}  // namespace haarlight::relight
