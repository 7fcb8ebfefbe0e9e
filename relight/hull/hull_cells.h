// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "relight/hull/shadow_hull.h"
#include "render/cell_mesh/vtu_writer.h"

/// @file
/// The hull's voxels as cells, for volume renderers and for other programs.

namespace haarlight::relight {

struct HullCells {
  /// Every voxel that is not empty, world frame, mm. Values of each:
  /// - state: VoxelState
  /// - opacity: 1 where it is taken as matter, 0 where it is assumed to be empty
  /// - lit_evidence, seen_fraction: VoxelEvidence, 0..1
  /// - height_low_mm, height_high_mm: over the plane, of the voxels above and below it up to the
  ///   next empty ones. Lights from above leave a cone over and under matter that they cannot
  ///   carve: the object is somewhere between, and need not fill it.
  render::HexahedralMesh mesh;
  double median_height_range_mm = 0.0;  ///< high - low over the cells; 0 without any
};

/// @throws Error  more than 2^31 corners: a .vtu of 32-bit indices cannot hold them
[[nodiscard]] HullCells hull_cells(const ShadowHull& hull);

}  // namespace haarlight::relight
