// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "relight/hull/carve.h"
#include "relight/hull/voxel_states.h"

/// @file
/// What must be there: a camera's ray that shows the object is blocked by something. Where no
/// voxel that is taken as matter stands in it, those of its voxels that hardly any light saw and
/// that matter encloses most (enclosed.h) are taken as matter; all of them where none is enclosed.
/// Without this a foot that stands flat on the plane is lost, since its shadow is hidden under it
/// from camera and lights alike.

namespace haarlight::relight {

struct Explanation {
  std::int64_t n_camera_rays = 0;         ///< that show the object and cross the grid
  std::int64_t n_camera_rays_filled = 0;  ///< of these, explained only by voxels hardly seen
  std::int64_t n_camera_rays_open = 0;    ///< of these, explained by nothing in the grid
};

/// Turns `assumed_empty` voxels that are needed into `assumed_full`: along each such ray,
/// those with at least half the largest chance in it.
/// @param chance  chance_of_matter() of each voxel
Explanation explain_camera_rays(const VoxelGrid& grid, std::span<const CarvingView> views,
                                const std::vector<float>& chance,
                                std::vector<VoxelState>& states);

}  // namespace haarlight::relight
