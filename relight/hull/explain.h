// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "relight/hull/carve.h"
#include "relight/hull/voxel_states.h"

/// @file
/// What must be there: a camera's ray that shows the object is blocked by something. Where no voxel
/// that is surely matter stands in it, the voxels in it that hardly any light saw are taken as
/// matter. Without this a foot that stands flat on the plane is lost, since its shadow is hidden
/// under it from camera and lights alike.

namespace haarlight::relight {

struct Explanation {
  std::int64_t n_camera_rays = 0;         ///< that show the object and cross the grid
  std::int64_t n_camera_rays_filled = 0;  ///< of these, explained only by voxels hardly seen
  std::int64_t n_camera_rays_open = 0;    ///< of these, explained by nothing in the grid
};

/// Turns `assumed_empty` voxels that are needed into `assumed_full`.
Explanation explain_camera_rays(const VoxelGrid& grid, std::span<const CarvingView> views,
                                std::vector<VoxelState>& states);

}  // namespace haarlight::relight
