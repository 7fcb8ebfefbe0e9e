// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "relight/hull/voxel_grid.h"
#include "relight/hull/voxel_states.h"

/// @file
/// How far matter encloses what nobody saw. The inside of a block and its far side throw their
/// shadows where the block itself hides the plane from the camera: hardly a light tells of them,
/// and left empty the block would be a shell, open at the back. Solids are likelier than shells:
/// a voxel that nobody saw is as likely matter as a random walk from it, through others that
/// nobody saw, ends at matter and not at what is known to be empty [Grady06]. Under something
/// that hangs freely most walks leave by the sides. docs/numerics/hull.md.

namespace haarlight::relight {

/// That chance for every `assumed_empty` voxel; 1 for matter and what is taken as matter, 0 for what
/// is empty, the grid's outside included. The plane reflects. Laplace's equation by successive
/// over-relaxation, one thread: seconds for 10^6 such voxels.
[[nodiscard]] std::vector<float> chance_of_matter(const VoxelGrid& grid,
                                                  const std::vector<VoxelState>& states);

}  // namespace haarlight::relight
