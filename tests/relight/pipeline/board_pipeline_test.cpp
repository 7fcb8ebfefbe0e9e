// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/board_pipeline.h"

#include <cmath>
#include <filesystem>

#include <Eigen/Geometry>
#include <fmt/format.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/rig/rig.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

using testing::TemporaryFolder;

constexpr int kWidth = 320;
constexpr int kHeight = 240;
constexpr double kSquare = 40.0;

/// small8 with a camera of 320 x 240.
std::string rig_text() {
  std::string text = read_file(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml", 1U << 20U);
  const auto replace = [&text](const std::string& from, const std::string& to) {
    const std::size_t at = text.find(from);
    ASSERT_NE(at, std::string::npos) << from;
    text.replace(at, from.size(), to);
  };
  replace("size = [64, 56]", "size = [320, 248]");
  replace("active_area = 48", "active_area = 240");
  replace("K = [[87.9192774, 0.0, 32.0], [0.0, 87.9192774, 24.0],",
          "K = [[440.0, 0.0, 160.0], [0.0, 440.0, 120.0],");
  return text;
}

/// A board of 9 x 6 corners and squares of 40 mm in closed form, by 3 x 3 samples per pixel:
/// each ray of the rig's camera meets the plane z = height in a square, or beside the board.
void draw_board(const std::filesystem::path& file, const CameraModel& camera, double height) {
  constexpr int kSub = 3;
  Image<float> picture(camera.height, camera.width, 1);
  for (int y = 0; y < camera.height * kSub; ++y) {
    for (int x = 0; x < camera.width * kSub; ++x) {
      const CameraRay ray = ray_through(camera, (x + 0.5) / kSub, (y + 0.5) / kSub);
      const double t = (height - ray.origin_world.z()) / ray.direction_world.z();
      const Eigen::Vector3d at = ray.origin_world + t * ray.direction_world;
      const int i = static_cast<int>(std::floor((at.x() + 160.0) / kSquare)) + 1;
      const int j = static_cast<int>(std::floor((at.y() + 100.0) / kSquare)) + 1;
      const bool is_board = i >= 0 && j >= 0 && i <= 9 && j <= 6;
      const double white = !is_board || (i + j) % 2 == 0 ? 0.85 : 0.06;
      picture(y / kSub, x / kSub) += static_cast<float>(white / (kSub * kSub));
    }
  }
  write_image(file, picture.view());
}

TEST(BoardPipeline, FindsThePlaneThatABoardLiesOn) {
  const TemporaryFolder folder;
  write_file_atomically(folder / "rig.toml", rig_text());
  const Rig rig = read_rig(folder / "rig.toml");
  const CameraModel& eye = rig.cameras[0].model;
  draw_board(folder / "board.png", eye, 12.0);
  write_image(folder / "empty.png", Image<float>(eye.height, eye.width, 1).view());
  BoardOptions options;
  options.rig = folder / "rig.toml";
  options.pictures = {folder / "board.png", folder / "empty.png"};
  options.board.square_mm = kSquare;
  const PlaneBoardSummary summary = calibrate_plane(options);
  EXPECT_EQ(summary.n_views, 1);
  // The plane z = 12: corners of a drawn picture are found to some hundredths of a pixel.
  EXPECT_LT((summary.plane.n - Eigen::Vector3d::UnitZ()).norm(), 3e-3);
  EXPECT_NEAR(summary.plane.d, -12.0, 1.0);
  EXPECT_LT(summary.moved_deg, 0.2);
  EXPECT_LT(summary.plane.rms_px, 0.2);
  EXPECT_TRUE(std::filesystem::exists(summary.page));
  EXPECT_EQ(summary.bytes, std::filesystem::file_size(folder / "rig.measured.toml"));
  ASSERT_GE(summary.notes.size(), 3U);
  EXPECT_NE(summary.notes[0].text.find("empty.png: no whole board"), std::string::npos);
  // The measured plane is what every program reads from now on.
  EXPECT_NEAR(read_rig(folder / "rig.toml").planes[0].d, -12.0, 1.0);
}

TEST(BoardPipeline, RefusesWhatIsNoBoardOrNoCamera) {
  const TemporaryFolder folder;
  write_file_atomically(folder / "rig.toml", rig_text());
  BoardOptions options;
  options.rig = folder / "rig.toml";
  EXPECT_THROW((void)calibrate_camera(options), Error);  // no pictures
  write_image(folder / "other.png", Image<float>(kHeight / 2, kWidth, 1).view());
  options.pictures = {folder / "other.png"};
  EXPECT_THROW((void)calibrate_camera(options), Error);  // of another size
  options.board.cols = 2;
  EXPECT_THROW((void)calibrate_plane(options), Error);
  options.board.cols = 9;
  options.camera = "nobody";
  EXPECT_THROW((void)calibrate_plane(options), Error);
  EXPECT_FALSE(std::filesystem::exists(folder / "rig.measured.toml"));
}

}  // namespace
}  // namespace haarlight::relight
