// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/hull_cells.h"

#include <cstddef>
#include <cstdint>
#include <limits>
#include <unordered_map>
#include <utility>

#include "core/order_statistics.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

/// The hull's corners that cells share.
class Corners {
 public:
  Corners(const VoxelGrid& grid, std::vector<std::array<float, 3>>& points)
      : grid_(grid), points_(points) {}

  std::int32_t index(int x, int y, int z) {
    const auto nx = static_cast<std::uint64_t>(grid_.nx) + 1;
    const auto ny = static_cast<std::uint64_t>(grid_.ny) + 1;
    const std::uint64_t key =
        (static_cast<std::uint64_t>(z) * ny + static_cast<std::uint64_t>(y)) * nx +
        static_cast<std::uint64_t>(x);
    const auto [at, is_new] =
        indices_.try_emplace(key, static_cast<std::int32_t>(points_.size()));
    if (is_new) {
      if (points_.size() >= std::size_t{std::numeric_limits<std::int32_t>::max()}) {
        throw Error("the hull has too many voxels for a .vtu file", "--voxel",
                    "take larger ones", ExitCode::usage);
      }
      const Eigen::Vector3d world = grid_.world_of(x, y, z);
      points_.push_back({static_cast<float>(world.x()), static_cast<float>(world.y()),
                         static_cast<float>(world.z())});
    }
    return at->second;
  }

 private:
  const VoxelGrid& grid_;
  std::vector<std::array<float, 3>>& points_;
  std::unordered_map<std::uint64_t, std::int32_t> indices_;
};

/// The layers from the first to past the last of the voxels around (x, y, z), up and down, that
/// are not empty.
std::pair<int, int> run_at(const ShadowHull& hull, int x, int y, int z) {
  const auto is_empty = [&](int layer) {
    return hull.states[hull.grid.index(x, y, layer)] == VoxelState::empty;
  };
  int low = z;
  while (low > 0 && !is_empty(low - 1)) {
    --low;
  }
  int high = z + 1;
  while (high < hull.grid.nz && !is_empty(high)) {
    ++high;
  }
  return {low, high};
}

}  // namespace

HullCells hull_cells(const ShadowHull& hull) {
  const VoxelGrid& grid = hull.grid;
  HullCells cells;
  std::vector<std::uint8_t> states;
  std::vector<std::uint8_t> opacities;
  std::vector<float> lit;
  std::vector<float> seen;
  std::vector<float> lows;
  std::vector<float> highs;
  std::vector<double> ranges;
  Corners corners(grid, cells.mesh.points);
  // VTK's lower side is anticlockwise from the upper one only in a right-handed frame.
  const bool is_right = grid.axes[0].cross(grid.axes[1]).dot(grid.axes[2]) > 0.0;
  for (int z = 0; z < grid.nz; ++z) {
    for (int y = 0; y < grid.ny; ++y) {
      for (int x = 0; x < grid.nx; ++x) {
        const VoxelState state = hull.states[grid.index(x, y, z)];
        if (state == VoxelState::empty) {
          continue;
        }
        const int lower = is_right ? z : z + 1;
        const int upper = is_right ? z + 1 : z;
        cells.mesh.cells.push_back(
            {corners.index(x, y, lower), corners.index(x + 1, y, lower),
             corners.index(x + 1, y + 1, lower), corners.index(x, y + 1, lower),
             corners.index(x, y, upper), corners.index(x + 1, y, upper),
             corners.index(x + 1, y + 1, upper), corners.index(x, y + 1, upper)});
        const VoxelEvidence& evidence = hull.evidence[states.size()];
        states.push_back(static_cast<std::uint8_t>(state));
        opacities.push_back(is_taken_as_matter(state) ? 1 : 0);
        lit.push_back(static_cast<float>(evidence.lit) / 255.0F);
        seen.push_back(static_cast<float>(evidence.seen) / 255.0F);
        const auto [low, high] = run_at(hull, x, y, z);
        lows.push_back(static_cast<float>(grid.height_of(low)));
        highs.push_back(static_cast<float>(grid.height_of(high)));
        ranges.push_back(grid.voxel_mm * (high - low));
      }
    }
  }
  if (!ranges.empty()) {
    cells.median_height_range_mm = median(std::move(ranges));
  }
  cells.mesh.values = {
      {"state", std::move(states)},       {"opacity", std::move(opacities)},
      {"lit_evidence", std::move(lit)},   {"seen_fraction", std::move(seen)},
      {"height_low_mm", std::move(lows)}, {"height_high_mm", std::move(highs)}};
  return cells;
}

}  // namespace haarlight::relight
