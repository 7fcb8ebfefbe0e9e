// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/hull_pipeline.h"

#include <filesystem>
#include <string>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/render/scene/scene.h"
#include "tests/relight/pipeline/captured_box.h"

namespace haarlight::relight {
namespace {

namespace fs = std::filesystem;

/// A box of 60 mm, 20 mm over the plane, under 64 lights.
class HullPipeline : public testing::CapturedBox {
 protected:
  void SetUp() override {
    capture("box.hlb", rig_);
    options_.captured.basis = folder_ / "box.hlb";
    options_.voxel_mm = 5.0;
    options_.settings.overwrites = true;
  }

  void expect_refused(const std::string& words) const {
    try {
      (void)export_hull(options_);
      FAIL() << "accepted";
    } catch (const Error& error) {
      EXPECT_NE(std::string(error.what()).find(words), std::string::npos) << error.what();
    }
    for (const std::string& file : options_.outputs) {
      EXPECT_FALSE(fs::exists(file)) << file;
    }
  }

  HullPipelineOptions options_;
};

TEST_F(HullPipeline, FindsTheBoxOverThePlane) {
  options_.outputs = {folder_ / "box.ply", folder_ / "box.vtu", folder_ / "box.png"};
  options_.n_smoothings = 0;
  const HullPipelineSummary summary = export_hull(options_);
  const HullSummary& hull = summary.source.hull;
  EXPECT_EQ(hull.voxel_mm, 5.0);
  EXPECT_TRUE(summary.source.is_carved);
  // What is carved is empty: what is left holds the box, but for voxels that its sides cut.
  EXPECT_GT(125.0 * static_cast<double>(summary.n_cells), 55.0 * 55.0 * 55.0);
  // What no light sees under so wide a box and behind it is taken as matter too: as much again.
  const double box_mm3 = 60.0 * 60.0 * 60.0;
  // The camera is so low that three quarters of the lights see no voxel of it: all is assumed.
  EXPECT_EQ(hull.n_matter, 0);
  EXPECT_GT(hull.n_assumed_full, 0);
  EXPECT_GT(summary.volume_mm3, 125.0 * static_cast<double>(hull.n_matter));
  EXPECT_GT(summary.volume_mm3, 0.5 * box_mm3);
  EXPECT_LT(summary.volume_mm3, 2.2 * box_mm3);
  EXPECT_LE(hull.low_mm, 20.0 + 5.0);
  EXPECT_GE(hull.high_mm, 80.0 - 5.0);
  EXPECT_GT(summary.median_height_range_mm, 60.0 - 10.0);
  const render::Scene scene = render::read_ply(folder_ / "box.ply");
  EXPECT_EQ(static_cast<std::int64_t>(scene.meshes.at(0).triangles.size()),
            summary.n_triangles);
  double volume = 0.0;
  for (const Eigen::Vector3i& t : scene.meshes[0].triangles) {
    const auto at = [&](int i) {
      return scene.meshes[0].vertices[static_cast<std::size_t>(t[i])];
    };
    volume += at(0).dot(at(1).cross(at(2))) / 6.0;
  }
  EXPECT_NEAR(volume, summary.volume_mm3, 1e-5 * summary.volume_mm3);  // floats
  EXPECT_EQ(summary.n_cells, hull.n_matter + hull.n_assumed_full + hull.n_assumed_empty);
  EXPECT_EQ(read_linear_image(folder_ / "box.png").width(), 960);
  std::uintmax_t bytes = 0;
  for (const std::string& file : options_.outputs) {
    bytes += fs::file_size(file);
  }
  EXPECT_EQ(summary.bytes, bytes);
  ASSERT_FALSE(summary.notes.empty());
  // The same hull is read, not carved again: by any of the commands that use it.
  options_.n_frames = 3;
  EXPECT_FALSE(export_hull(options_).source.is_carved);
  EXPECT_EQ(read_linear_image(folder_ / "box.png").height(), 3 * 360);
}

TEST_F(HullPipeline, ASecondCameraCarvesMore) {
  options_.outputs = {folder_ / "box.vtu"};
  const std::int64_t one = export_hull(options_).n_cells;
  std::string turned = testing::replaced(
      rig_,
      "[1, 0, 0, 0],\n    [-0, -0.643509750887, 0.765437914212, -560],\n    [0, "
      "-0.765437914212, -0.643509750887, 520]",
      "[-1, 0, 0, 0],\n    [0, 0.643509750887, -0.765437914212, 560],\n    [0, "
      "-0.765437914212, -0.643509750887, 520]");
  EXPECT_EQ(export_hull(options_).n_triangles, 0);  // cells need no surface
  capture("two.hlb", turned);
  options_.captured.also = {folder_ / "two.hlb"};
  EXPECT_LT(export_hull(options_).n_cells, one * 9 / 10);
}

TEST_F(HullPipeline, RefusesNamesThatSayNoFormat) {
  options_.outputs = {folder_ / "box.stl"};
  expect_refused("written as .ply, .vtu or .png");
  options_.outputs = {folder_ / "a.ply", folder_ / "b.ply"};
  expect_refused("a second output that ends in .ply");
  options_.outputs = {folder_ / "a.ply"};
  options_.n_frames = 3;
  expect_refused("--frames are views in a .png");
}

TEST_F(HullPipeline, SaysThatThereIsNoObject) {
  write_file_atomically(folder_ / "box.toml",
                        "schema = 1\nname = \"none\"\n[[material]]\nname = \"m\"\nkd = [0.3]\n"
                        "[[box]]\nlow = [9000.0, 9000.0, 20.0]\nhigh = [9001.0, 9001.0, "
                        "21.0]\nmaterial = \"m\"\n");
  capture("none.hlb", rig_);
  options_.captured.basis = folder_ / "none.hlb";
  options_.outputs = {folder_ / "none.ply"};
  expect_refused("the captures show no object");
}

TEST_F(HullPipeline, VoxelsTooSmallForTheMemoryAreRefused) {
  options_.voxel_mm = 0.01;
  options_.outputs = {folder_ / "box.ply"};
  expect_refused("MiB of memory");
}

}  // namespace
}  // namespace haarlight::relight
