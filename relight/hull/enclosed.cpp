// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/enclosed.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace haarlight::relight {

namespace {

// Over-relaxation for unseen regions of some hundred voxels across, and when it has converged.
constexpr float kOver = 1.9F;
constexpr int kMostSweeps = 300;
constexpr float kSmallChange = 1e-3F;

/// One voxel in its grid of chances: the mean of its neighbours minus itself.
float excess(const VoxelGrid& grid, const std::vector<float>& chance, int x, int y, int z,
             std::size_t i) {
  const auto nx = static_cast<std::size_t>(grid.nx);
  const std::size_t layer = nx * static_cast<std::size_t>(grid.ny);
  float sum = 0.0F;
  sum += x > 0 ? chance[i - 1] : 0.0F;
  sum += x + 1 < grid.nx ? chance[i + 1] : 0.0F;
  sum += y > 0 ? chance[i - nx] : 0.0F;
  sum += y + 1 < grid.ny ? chance[i + nx] : 0.0F;
  sum += z + 1 < grid.nz ? chance[i + layer] : 0.0F;
  if (z > 0) {
    sum += chance[i - layer];
  } else if (grid.low.z() <= 0.0) {
    return sum / 5.0F - chance[i];  // on the plane
  }
  return sum / 6.0F - chance[i];
}

}  // namespace

std::vector<float> chance_of_matter(const VoxelGrid& grid,
                                    const std::vector<VoxelState>& states) {
  std::vector<float> chance(states.size());
  std::transform(states.begin(), states.end(), chance.begin(),
                 [](VoxelState state) { return is_taken_as_matter(state) ? 1.0F : 0.0F; });
  float change = 1.0F;
  for (int sweep = 0; sweep < kMostSweeps && change > kSmallChange; ++sweep) {
    change = 0.0F;
    std::size_t i = 0;
    for (int z = 0; z < grid.nz; ++z) {
      for (int y = 0; y < grid.ny; ++y) {
        for (int x = 0; x < grid.nx; ++x, ++i) {
          if (states[i] == VoxelState::assumed_empty) {
            const float step = kOver * excess(grid, chance, x, y, z, i);
            chance[i] += step;
            change = std::max(change, std::abs(step));
          }
        }
      }
    }
  }
  return chance;
}

}  // namespace haarlight::relight
