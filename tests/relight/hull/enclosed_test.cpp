// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/enclosed.h"

#include <gtest/gtest.h>

#include "relight/hull/explain.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

VoxelGrid cubes(int nx, int ny, int nz, double low_z = 0.0) {
  VoxelGrid grid;
  grid.low.z() = low_z;
  grid.nx = nx;
  grid.ny = ny;
  grid.nz = nz;
  return grid;
}

TEST(Enclosed, FallsEvenlyBetweenTwoWalls) {
  // Closed form: between a wall of matter and an empty one, both without end, the chance is linear.
  // What comes in by the slab's sides falls by exp(-pi/11) a voxel, to 4e-8 in the middle. 2e-3: where
  // the relaxation ends.
  const VoxelGrid grid = cubes(121, 121, 11, 5.0);
  std::vector<VoxelState> states(grid.size(), VoxelState::assumed_empty);
  for (int y = 0; y < grid.ny; ++y) {
    for (int x = 0; x < grid.nx; ++x) {
      states[grid.index(x, y, 10)] = VoxelState::matter;
    }
  }
  const std::vector<float> chance = chance_of_matter(grid, states);
  for (int z = 0; z < 10; ++z) {
    EXPECT_NEAR(chance[grid.index(60, 60, z)], (z + 1) / 11.0, 2e-3) << z;
  }
}

TEST(Enclosed, ThePlaneReflects) {
  // Under matter without end, on the plane: nowhere to leave, but at the sides, far away.
  const VoxelGrid grid = cubes(121, 121, 6);
  std::vector<VoxelState> states(grid.size(), VoxelState::assumed_empty);
  for (int y = 0; y < grid.ny; ++y) {
    for (int x = 0; x < grid.nx; ++x) {
      states[grid.index(x, y, 5)] = VoxelState::matter;
    }
  }
  const std::vector<float> chance = chance_of_matter(grid, states);
  EXPECT_NEAR(chance[grid.index(60, 60, 0)], 1.0, 2e-3);
  EXPECT_LT(chance[grid.index(0, 60, 0)], 0.5);
}

TEST(Enclosed, ABlockIsSolidAndTheAirUnderAPlateIsNot) {
  // Of a block 20 voxels wide and high, the top and three sides were seen, one voxel thick; of a plate
  // as wide only itself. What is under both was not.
  const VoxelGrid grid = cubes(40, 40, 30);
  std::vector<VoxelState> block(grid.size(), VoxelState::empty);
  std::vector<VoxelState> plate(grid.size(), VoxelState::empty);
  for (int z = 0; z < 20; ++z) {
    for (int y = 10; y < 30; ++y) {
      for (int x = 10; x < 30; ++x) {
        const std::size_t i = grid.index(x, y, z);
        block[i] = z == 19 || x == 10 || x == 29 || y == 10 ? VoxelState::matter
                                                            : VoxelState::assumed_empty;
        plate[i] = z == 19 ? VoxelState::matter : VoxelState::assumed_empty;
      }
    }
  }
  const std::size_t middle = grid.index(20, 20, 5);
  EXPECT_GT(chance_of_matter(grid, block)[middle],
            0.75);  // one of six directions is open, the plane shut
  EXPECT_LT(chance_of_matter(grid, plate)[middle],
            0.15);  // the first mode: exp(-pi sqrt(2)/20 14) = 0.04, 1.6 times
}

TEST(Enclosed, KnownVoxelsKeepTheirs) {
  const VoxelGrid grid = cubes(4, 1, 1);
  const std::vector<VoxelState> states{VoxelState::matter, VoxelState::assumed_empty,
                                       VoxelState::empty, VoxelState::assumed_full};
  const std::vector<float> chance = chance_of_matter(grid, states);
  EXPECT_EQ(chance[0], 1.0F);
  EXPECT_EQ(chance[2], 0.0F);
  EXPECT_EQ(chance[3], 1.0F);
  EXPECT_NEAR(chance[1], 0.2, 1e-3);  // five neighbours, the plane below, one of them matter
}

TEST(Explain, FillsARayWhereMatterEnclosesItMost) {
  // A camera far above looks straight down on one column of unseen voxels; matter stands beside its
  // upper part only.
  const VoxelGrid grid = cubes(3, 3, 40);
  std::vector<VoxelState> states(grid.size(), VoxelState::empty);
  for (int z = 0; z < grid.nz; ++z) {
    states[grid.index(1, 1, z)] = VoxelState::assumed_empty;
    if (z >= 30) {
      states[grid.index(0, 1, z)] = VoxelState::matter;
      states[grid.index(2, 1, z)] = VoxelState::matter;
    }
  }
  CarvingView view;
  view.camera.width = view.camera.height = 1;
  view.camera.fx = view.camera.fy = 1e4;
  view.camera.cx = view.camera.cy = 0.5;
  view.camera.world_from_cam = look_at({1.5, 1.5, 1000.0}, {1.5, 1.5, 0.0}, Vector3d::UnitY());
  view.shows_plane = Image<std::uint8_t>(1, 1, 1);
  view.shows_object = Image<std::uint8_t>(1, 1, 1);
  view.shows_object(0, 0) = 1;
  const Explanation explained =
      explain_camera_rays(grid, {{view}}, chance_of_matter(grid, states), states);
  EXPECT_EQ(explained.n_camera_rays_filled, 1);
  for (int z = 0; z < grid.nz; ++z) {
    const VoxelState state = states[grid.index(1, 1, z)];
    if (z > 30 && z < 39) {
      EXPECT_EQ(state, VoxelState::assumed_full) << z;
    } else if (z < 28) {
      EXPECT_EQ(state, VoxelState::assumed_empty) << z;
    }
  }
}

}  // namespace
}  // namespace haarlight::relight
