// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/shadow_pipeline.h"

#include <filesystem>
#include <numbers>
#include <string>
#include <utility>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/relight/basis/compress_session.h"
#include "haarlight/relight/shadow/receiver_light.h"
#include "haarlight/render/light/rig_lights.h"
#include "relight/hull/hull_file.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

using testing::TemporaryFolder;

Rig small_rig() { return read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml"); }

/// A capture of nothing: the rig's empty plane. Its receiver is a plane of that height, or
/// lower.
class ShadowPipeline : public ::testing::Test {
 protected:
  void SetUp() override {
    CompressOptions compress;
    compress.relative_l2 = 1e-4;
    (void)compress_plate(rig_, folder_ / "empty.hlb", compress);
    options_.captured.basis = folder_ / "empty.hlb";
    options_.output = folder_ / "shadow.exr";
    options_.light.lights = {"27=2"};
    put_ground(0.0);
  }
  void put_ground(double z) {
    write_file_atomically(
        folder_ / "ground.toml",
        "schema = 1\nname = \"ground\"\n[[material]]\nname = \"m\"\nkd = [0.6, 0.3, 0.1]\n"
        "[[box]]\nlow = [-3000.0, -3000.0, -900.0]\nhigh = [3000.0, 3000.0, " +
            std::to_string(z) + "]\nmaterial = \"m\"\n");
    options_.scene = folder_ / "ground.toml";
  }
  /// rho/pi E of light 27 at weight 2, where the middle of a pixel meets the ground.
  [[nodiscard]] double expected(int y, int x, double rho) const {
    const CameraRay ray = ray_through(rig_.cameras[0].model, x + 0.5, y + 0.5);
    const Eigen::Vector3d point =
        ray.origin_world - ray.origin_world.z() / ray.direction_world.z() * ray.direction_world;
    return 2.0 * rho / std::numbers::pi *
           receiver_irradiance(render::rig_lights(rig_)[27], point, Eigen::Vector3d::UnitZ());
  }

  Rig rig_ = small_rig();
  TemporaryFolder folder_;
  ShadowOptions options_;
};

TEST_F(ShadowPipeline, AnEmptyPlaneCastsNoShadow) {
  options_.subpixels = 1;
  const ShadowSummary summary = cast_shadow(options_);
  EXPECT_EQ(summary.n_planes, 1U);
  EXPECT_EQ(summary.reprojected.n_lights, 1);
  const CameraModel& eye = rig_.cameras[0].model;
  EXPECT_EQ(summary.reprojected.n_receivers, std::int64_t{eye.width} * eye.height);
  EXPECT_NEAR(summary.reprojected.on_fraction, 1.0, 1e-12);
  EXPECT_TRUE(summary.reprojected.points.is_exact);
  ASSERT_EQ(summary.plates.size(), 1U);
  EXPECT_GT(summary.plates[0].known_fraction, 0.9);
  EXPECT_EQ(summary.exposure, 1.0);
  EXPECT_FALSE(summary.object);
  EXPECT_EQ(summary.bytes, std::filesystem::file_size(options_.output));
  const Image<float> picture = read_linear_image(options_.output);
  const int y = eye.height / 2;
  const int x = eye.width / 2;
  // The clean plate's own error (1e-4) and its scale's; V is at most 1.
  EXPECT_NEAR(picture(y, x, 0), expected(y, x, 0.6), 2e-3 * expected(y, x, 0.6));
  EXPECT_NEAR(picture(y, x, 2), expected(y, x, 0.1), 2e-3 * expected(y, x, 0.1));
}

TEST_F(ShadowPipeline, AgreesWithTheTracedShadowOfNothing) {
  put_ground(-40.0);
  write_file_atomically(folder_ / "none.toml",
                        "schema = 1\nname = \"none\"\n[[material]]\nname = \"m\"\n"
                        "kd = [0.5, 0.5, 0.5]\n[[box]]\nlow = [9000.0, 9000.0, -10.0]\n"
                        "high = [9001.0, 9001.0, -9.0]\nmaterial = \"m\"\n");
  options_.truth_object = folder_ / "none.toml";
  options_.truth = folder_ / "truth.exr";
  options_.difference = folder_ / "difference.exr";
  options_.subpixels = 1;
  const ShadowSummary summary = cast_shadow(options_);
  EXPECT_NEAR(summary.reprojected.below_fraction, 1.0, 1e-12);
  ASSERT_TRUE(summary.truth);
  EXPECT_LT(summary.truth->achieved.relative_l2, 2e-3);
  EXPECT_TRUE(summary.truth->shadow);
  EXPECT_FALSE(summary.truth->object);
  std::uintmax_t bytes = 0;
  for (const char* name : {"shadow.exr", "truth.exr", "difference.exr"}) {
    bytes += std::filesystem::file_size(folder_ / name);
  }
  EXPECT_EQ(summary.bytes, bytes);
}

TEST_F(ShadowPipeline, TheHullIsCarvedOnceAndKept) {
  options_.subpixels = 1;
  options_.size = {16, 12};
  put_ground(20.0);  // above the plane: pictures of it do not tell
  const ShadowSummary carved = cast_shadow(options_);
  ASSERT_TRUE(carved.hull);
  EXPECT_TRUE(carved.hull->is_carved);
  EXPECT_EQ(carved.hull->hull.n_matter + carved.hull->hull.n_assumed_full, 0);
  EXPECT_NEAR(carved.reprojected.occluder_fraction, 1.0, 1e-12);
  EXPECT_EQ(carved.hull->file, folder_ / "empty.hlb.hull");
  ASSERT_TRUE(std::filesystem::exists(folder_ / "empty.hlb.hull"));
  options_.settings.overwrites = true;
  const std::string picture = read_file(options_.output);
  EXPECT_FALSE(cast_shadow(options_).hull->is_carved);
  EXPECT_EQ(read_file(options_.output), picture);
  // Planes that are not this capture's.
  const std::string file = folder_ / "empty.hlb.hull";
  const std::string key = read_file(file).substr(8, 32);
  ShadowHull other = read_hull(file);
  ASSERT_EQ(other.planes.size(), 1U);
  other.planes[0].shows_plane = Image<std::uint8_t>(3, 3, 1);
  other.planes[0].shows_object = Image<std::uint8_t>(3, 3, 1);
  write_hull(other, key, file);
  EXPECT_TRUE(cast_shadow(options_).hull->is_carved);
  other.planes.clear();
  write_hull(other, key, file);
  EXPECT_TRUE(cast_shadow(options_).hull->is_carved);
  EXPECT_EQ(read_file(options_.output), picture);
  // What it came from has changed: carved again.
  options_.hull_voxel_mm = 20.0;
  EXPECT_TRUE(cast_shadow(options_).hull->is_carved);
  // The pictures alone need none.
  options_.method = ShadowMethod::plane;
  std::filesystem::remove(folder_ / "empty.hlb.hull");
  EXPECT_FALSE(cast_shadow(options_).hull);
  EXPECT_FALSE(std::filesystem::exists(folder_ / "empty.hlb.hull"));
}

TEST_F(ShadowPipeline, RefusesACameraThatRenderAloneKnowsAndSaysWhatToLeaveOut) {
  const std::string ground = read_file(folder_ / "ground.toml") +
                             "[camera]\nsize = [16, 12]\neye = [0, -500, 400]\n"
                             "target = [0, 0, 0]\n";
  const std::pair<const char*, const char*> views[] = {
      {"width_mm = 300", "width_mm"},
      {"fov_y_deg = 40\nlens_radius_mm = 2\nfocus_mm = 600", "lens_radius_mm"},
      {"fov_y_deg = 40\nnear_mm = 9", "near_mm"},
      {"fov_y_deg = 40\nfar_mm = 900", "far_mm"}};
  for (const auto& [keys, name] : views) {
    write_file_atomically(folder_ / "view.toml", ground + keys + "\n");
    options_.scene = folder_ / "view.toml";
    try {
      (void)cast_shadow(options_);
      ADD_FAILURE() << keys;
    } catch (const Error& error) {
      EXPECT_NE(error.where().find("view.toml"), std::string::npos) << error.what();
      EXPECT_NE(error.hint().find(name), std::string::npos) << error.hint();
    }
    EXPECT_FALSE(std::filesystem::exists(options_.output));
  }
}

TEST_F(ShadowPipeline, RefusesContradictionsBeforeItWritesAnything) {
  options_.truth = folder_ / "truth.exr";  // of which object?
  EXPECT_THROW((void)cast_shadow(options_), Error);
  options_.truth.clear();
  options_.with_object = true;  // how bright?
  EXPECT_THROW((void)cast_shadow(options_), Error);
  options_.with_object = false;
  options_.background = 0.0;  // of which environment?
  EXPECT_THROW((void)cast_shadow(options_), Error);
  options_.background.reset();
  options_.captured.planes = {"no such plane"};
  EXPECT_THROW((void)cast_shadow(options_), Error);
  EXPECT_FALSE(std::filesystem::exists(options_.output));
}

}  // namespace
}  // namespace haarlight::relight
