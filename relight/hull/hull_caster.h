// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/scene.h"
#include "relight/hull/shadow_hull.h"
#include "relight/shadow/occluder.h"

/// @file
/// How much of a square light a point sees past a shadow hull: rays to a grid of points on the
/// light, through the voxels, stepping over empty space by a distance table [Chebyshev distance
/// in voxels]. Lights whose whole pyramid is clear of the hull need no ray. Safe from any thread.

namespace haarlight::relight {

class HullCaster final : public Occluder {
 public:
  /// Keeps three bytes per voxel; borrows nothing.
  /// @param n_rays  per side of a light that is neither all visible nor all hidden
  explicit HullCaster(const ShadowHull& hull, int n_rays = 6);

  /// `low`: past everything that may be matter; `high`: past matter alone.
  [[nodiscard]] OccluderLook look(const Eigen::Vector3d& point,
                                  const render::SquareLight& light) const override;
  [[nodiscard]] double resolution_mm() const override { return grid_.voxel_mm; }

 private:
  struct Blocked {
    bool by_matter = false;
    bool by_assumed_full = false;
    bool by_assumed_empty = false;
  };
  [[nodiscard]] Blocked cast(const Eigen::Vector3d& from, const Eigen::Vector3d& to) const;
  [[nodiscard]] bool is_clear(const Eigen::Vector3d& from, const Eigen::Vector3d& to,
                              double radius) const;

  VoxelGrid grid_;
  int n_rays_;
  std::vector<VoxelState> states_;
  std::vector<std::uint8_t> distance_;  ///< to the nearest voxel that is not empty; 0: itself
  std::vector<std::uint8_t> solid_distance_;  ///< to the nearest of matter or assumed full
};

}  // namespace haarlight::relight
