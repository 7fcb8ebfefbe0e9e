// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/explain.h"

#include <algorithm>

#include "relight/hull/voxel_walk.h"

namespace haarlight::relight {

namespace {

constexpr double kFar = 1e5;       // voxels along a camera ray
constexpr float kNearBest = 0.5F;  // of a ray's largest chance

enum class Found { matter, unseen, nothing };

/// What a ray meets; the unseen voxels in it are added to `unseen`.
Found follow(const VoxelGrid& grid, const std::vector<VoxelState>& states,
             const Eigen::Vector3d& from, const Eigen::Vector3d& to,
             std::vector<std::size_t>& unseen) {
  unseen.clear();
  Found found = Found::nothing;
  walk_voxels(grid, from, to, 0.0, [&](std::size_t i, double) {
    if (is_taken_as_matter(states[i])) {
      found = Found::matter;
      return 0;
    }
    if (states[i] != VoxelState::empty) {
      found = Found::unseen;
      unseen.push_back(i);
    }
    return 1;
  });
  return found;
}

/// Of a ray's unseen voxels those that are likeliest matter.
void keep_likeliest(const std::vector<float>& chance, std::vector<std::size_t>& unseen) {
  float most = 0.0F;
  for (const std::size_t i : unseen) {
    most = std::max(most, chance[i]);
  }
  std::erase_if(unseen, [&](std::size_t i) { return chance[i] < kNearBest * most; });
}

}  // namespace

Explanation explain_camera_rays(const VoxelGrid& grid, std::span<const CarvingView> views,
                                const std::vector<float>& chance,
                                std::vector<VoxelState>& states) {
  Explanation explanation;
  std::vector<std::size_t> unseen;
  std::vector<std::size_t> filled;
  for (const CarvingView& view : views) {
    for (int y = 0; y < view.shows_plane.height(); ++y) {
      for (int x = 0; x < view.shows_plane.width(); ++x) {
        if (view.shows_object(y, x) == 0) {
          continue;
        }
        const CameraRay ray = ray_through(view.camera, x + 0.5, y + 0.5);
        const Eigen::Vector3d from = grid.grid_of(ray.origin_world);
        const Eigen::Vector3d to = grid.grid_of(ray.origin_world + ray.direction_world);
        double begin = 0.0;
        double end = kFar;
        if (!clip_to_grid(grid, from, to - from, 0.0, begin, end)) {
          continue;
        }
        ++explanation.n_camera_rays;
        switch (follow(grid, states, from, from + kFar * (to - from).normalized(), unseen)) {
          case Found::matter:
            break;
          case Found::unseen:
            ++explanation.n_camera_rays_filled;
            keep_likeliest(chance, unseen);
            filled.insert(filled.end(), unseen.begin(), unseen.end());
            break;
          case Found::nothing:
            ++explanation.n_camera_rays_open;
            break;
        }
      }
    }
  }
  for (const std::size_t i : filled) {
    states[i] = VoxelState::assumed_full;
  }
  return explanation;
}

}  // namespace haarlight::relight
