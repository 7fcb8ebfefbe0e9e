// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/camera_depths.h"

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "tests/relight/shadow/shadow_scene.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

/// A camera straight above; voxels of 2 mm in a column of 10: matter in layers 5 to 7, assumed
/// empty in layer 1, nothing else.
class DepthsFromAbove : public ::testing::Test {
 protected:
  DepthsFromAbove() {
    hull_.grid = make_voxel_grid(shadow_scene::ground(), 1.0,
                                 {{-8.0, -8.0, 0.0}, {8.0, 8.0, 20.0}}, 2.0);
    hull_.states.assign(hull_.grid.size(), VoxelState::empty);
    for (int y = 3; y < 5; ++y) {
      for (int x = 3; x < 5; ++x) {
        for (int z = 5; z < 8; ++z) {
          hull_.states[hull_.grid.index(x, y, z)] = VoxelState::matter;
        }
        hull_.states[hull_.grid.index(x, y, 1)] = VoxelState::assumed_empty;
      }
    }
    camera_.width = camera_.height = 40;
    camera_.fx = camera_.fy = 500.0;
    camera_.cx = camera_.cy = 20.0;
    camera_.world_from_cam = look_at({0, 0, 300}, {0, 0, 0}, {0, 1, 0});
    wanted_ = Image<std::uint8_t>(40, 40, 1);
    std::fill(wanted_.pixels().begin(), wanted_.pixels().end(), std::uint8_t{1});
  }

  ShadowHull hull_;
  CameraModel camera_;
  Image<std::uint8_t> wanted_;
};

TEST_F(DepthsFromAbove, AreThoseOfTheVoxels) {
  const CameraDepths depths = camera_depths(hull_, camera_, wanted_.view());
  EXPECT_EQ(depths.n_wanted, 1600);
  // In the middle, where the ray is nearly along z: top at 16 mm, under side of layer 5 at 10,
  // of layer 1 at 2.
  EXPECT_NEAR(depths.possible.nearest(20, 20), 300.0 - 16.0, 0.02);
  EXPECT_NEAR(depths.possible.furthest(20, 20), 300.0 - 2.0, 0.02);
  EXPECT_NEAR(depths.likely.nearest(20, 20), 300.0 - 16.0, 0.02);
  EXPECT_NEAR(depths.likely.furthest(20, 20), 300.0 - 10.0, 0.02);
  // The voxels' column is 4 mm wide: some 7 pixels at 290 mm.
  EXPECT_EQ(depths.possible.nearest(20, 5), 0.0F);
  EXPECT_GT(depths.n_met, 36);
  EXPECT_LT(depths.n_met, 81);
}

/// Everything that a ray meets lies between the bounds, and they are no looser than a voxel's
/// diagonal.
TEST_F(DepthsFromAbove, EncloseEachVoxelOnASlantingRay) {
  camera_.world_from_cam = look_at({200, -90, 210}, {0, 0, 10}, {0, 0, 1});
  const CameraDepths depths = camera_depths(hull_, camera_, wanted_.view());
  int n = 0;
  for (int y = 0; y < 40; ++y) {
    for (int x = 0; x < 40; ++x) {
      const CameraRay ray = ray_through(camera_, x + 0.5, y + 0.5);
      double first = 0.0;
      double last = 0.0;
      for (double t = 200.0; t < 400.0; t += 0.02) {  // the definition, by small steps
        const Vector3d at = hull_.grid.grid_of(ray.origin_world + t * ray.direction_world);
        const auto cell = [&](int axis) { return static_cast<int>(std::floor(at[axis])); };
        if (cell(0) < 0 || cell(0) >= hull_.grid.nx || cell(1) < 0 ||
            cell(1) >= hull_.grid.ny || cell(2) < 0 || cell(2) >= hull_.grid.nz ||
            hull_.states[hull_.grid.index(cell(0), cell(1), cell(2))] == VoxelState::empty) {
          continue;
        }
        first = first == 0.0 ? t : first;
        last = t;
      }
      if (first == 0.0) {
        continue;
      }
      ++n;
      EXPECT_LE(depths.possible.nearest(y, x), first + 0.02);
      EXPECT_GE(depths.possible.furthest(y, x), last - 0.02);
      EXPECT_GE(depths.possible.nearest(y, x), first - 2.0 * std::sqrt(3.0));
      EXPECT_LE(depths.possible.furthest(y, x), last + 2.0 * std::sqrt(3.0));
    }
  }
  EXPECT_GT(n, 50);
}

TEST_F(DepthsFromAbove, AreLookedAtWhereWanted) {
  std::fill(wanted_.pixels().begin(), wanted_.pixels().end(), std::uint8_t{0});
  wanted_(20, 20) = 1;
  const CameraDepths depths = camera_depths(hull_, camera_, wanted_.view());
  EXPECT_EQ(depths.n_wanted, 1);
  EXPECT_EQ(depths.n_met, 1);
  EXPECT_EQ(depths.possible.nearest(20, 21), 0.0F);
  // All that meets matter but 5 x 5 pixels around.
  std::fill(wanted_.pixels().begin(), wanted_.pixels().end(), std::uint8_t{1});
  const std::int64_t n_all = camera_depths(hull_, camera_, wanted_.view()).n_met;
  EXPECT_EQ(depths.n_elsewhere, n_all - 25);
  EXPECT_THROW((void)camera_depths(hull_, camera_, Image<std::uint8_t>(3, 3, 1).view()),
               ContractViolation);
}

}  // namespace
}  // namespace haarlight::relight
