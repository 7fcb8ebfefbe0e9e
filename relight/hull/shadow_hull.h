// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "relight/hull/carve.h"
#include "relight/hull/explain.h"
#include "relight/hull/voxel_grid.h"
#include "relight/hull/voxel_states.h"
#include "relight/shadow/found_plane.h"
#include "relight/shadow/plane_offset.h"

/// @file
/// The shadow hull: the occluder that a capture's own shadow pictures and its camera leave
/// possible, a voxel grid over the shadow plane. docs/numerics/hull.md.

namespace haarlight::relight {

struct HullOptions {
  CarveOptions carve;
  /// Nothing is higher over the plane; unknown: the lights. A lowest point is of no use here: what
  /// the object stands on casts a shadow too.
  std::optional<double> highest_mm;
  double voxel_mm = 0.0;  ///< 0: as fine as the plane picture allows within `max_voxels`
  std::int64_t max_voxels = std::int64_t{1} << 21U;
  /// A voxel is taken as matter if at least this fraction of the lights saw where its shadow would
  /// fall, and none saw it lit; from `surely_seen` on it counts as such in the upper bound too.
  double least_seen = 0.2;
  double surely_seen = 0.75;
  /// One that was seen by fewer is taken as matter if it is enclosed this far (enclosed.h).
  double least_enclosed = 0.3;
};

struct HullSummary {
  double voxel_mm = 0.0;
  std::int64_t n_voxels = 0;
  std::int64_t n_empty = 0;
  std::int64_t n_matter = 0;
  std::int64_t n_assumed_full = 0;
  std::int64_t n_assumed_empty = 0;
  double low_mm = 0.0;  ///< over the plane, of what is taken as matter
  double high_mm = 0.0;
  bool touches_border =
      false;  ///< matter at the grid's side: the object is larger than the plane's picture
  bool leaves_camera = false;  ///< a camera's picture shows the object up to its border
  PlaneOffset offset;          ///< of the plane that is farthest from where the rig file has it
  std::string offset_plane;    ///< which one: file and id
  Explanation explained;
  int n_lights = 0;
  std::uint64_t n_lookups = 0;
};

/// What the pictures say of a voxel that is not empty, in 1/255.
struct VoxelEvidence {
  std::uint8_t lit = 0;   ///< of the evidence that makes a voxel empty
  std::uint8_t seen = 0;  ///< of the lights: their beam ended on known points
  friend bool operator==(const VoxelEvidence&, const VoxelEvidence&) = default;
};

struct ShadowHull {
  VoxelGrid grid;
  std::vector<VoxelState> states;       ///< in the grid's order
  std::vector<VoxelEvidence> evidence;  ///< of those that are not empty, in the same order
  HullSummary summary;
  std::vector<FoundPlane> planes;  ///< of each capture's each plane, as the captures are opened
};

/// @throws Error  so few lights shine on the plane that they cannot agree on an empty voxel
void require_lights(const PlaneFrame& frame, std::span<const render::SquareLight> lights,
                    const CarveOptions& options = {});

/// Carves coarsely to find where the object is, then finely there.
/// @throws Error  too few lights shine on the first plane to prove anything empty; voxels too
///                small for the memory
[[nodiscard]] ShadowHull build_hull(std::span<const SamplingPlane> planes,
                                    std::span<const render::SquareLight> lights,
                                    std::span<const CarvingView> views,
                                    const HullOptions& options = {});

/// @throws Error  nothing of it is taken as matter: the captures show no object
void require_object(const ShadowHull& hull, const std::string& basis);

}  // namespace haarlight::relight
