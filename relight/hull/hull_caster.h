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
/// in voxels]. A light needs none where its whole pyramid is clear of the hull, or filled by matter
/// somewhere. Safe from any thread.

namespace haarlight::relight {

class HullCaster final : public Occluder {
 public:
  /// Keeps five bytes per voxel; borrows nothing.
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
  /// Towards a light, in voxels; `radius` at its end.
  struct Cone {
    Eigen::Vector3d from;
    Eigen::Vector3d to;
    double radius;
  };
  /// @param begin  where on the line to begin, 0..1
  /// @param is_solid_clear  no matter and nothing taken as such is in the way: the first voxel that may
  ///                        be matter decides
  [[nodiscard]] Blocked cast(const Eigen::Vector3d& from, const Eigen::Vector3d& to,
                             double begin, bool is_solid_clear) const;
  /// How far along its line the cone is surely clear of a kind of voxels; 1: all of it.
  /// @param distance  to the nearest of them
  [[nodiscard]] double clear_until(const Cone& cone,
                                   const std::vector<std::uint8_t>& distance) const;
  /// Whether a kind of voxels surely fills some section of the cone.
  /// @param depth     of each in its kind
  /// @param distance  to the nearest of them, or less
  [[nodiscard]] bool is_filled(const Cone& cone, double begin,
                               const std::vector<std::uint8_t>& depth,
                               const std::vector<std::uint8_t>& distance) const;

  VoxelGrid grid_;
  int n_rays_;
  std::vector<VoxelState> states_;
  std::vector<std::uint8_t> distance_;  ///< to the nearest voxel that is not empty; 0: itself
  std::vector<std::uint8_t> solid_distance_;  ///< to the nearest of matter or assumed full
  /// From the nearest voxel that is not matter, or is empty, and from the grid's sides; 0: itself.
  std::vector<std::uint8_t> matter_depth_;
  std::vector<std::uint8_t> any_depth_;
};

}  // namespace haarlight::relight
