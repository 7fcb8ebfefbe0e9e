// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/scene/scene.h"
#include "relight/hull/shadow_hull.h"
#include "relight/shadow/occluder.h"

/// @file
/// How much of a square light a point sees past a shadow hull: rays to a grid of points on the
/// light, through the voxels, stepping over empty space by a distance table [Chebyshev distance
/// in voxels]. A light needs none where its whole pyramid is clear of the hull, or filled by it
/// somewhere. Safe from any thread.

namespace haarlight::relight {

class HullCaster final : public Occluder {
 public:
  /// Keeps seven bytes per voxel; borrows nothing.
  /// @param n_rays  per side of a light that is neither all visible nor all hidden
  explicit HullCaster(const ShadowHull& hull, int n_rays = 6);

  /// `low`: past everything that may be matter; `high`: past matter alone.
  [[nodiscard]] OccluderLook look(const Eigen::Vector3d& point,
                                  const render::SquareLight& light) const override;
  [[nodiscard]] std::optional<OccluderLook> look_at_all(const Eigen::Vector3d& point,
                                                        const Eigen::Vector3d& centre,
                                                        double radius_mm) const override;
  [[nodiscard]] double resolution_mm() const override { return grid_.voxel_mm; }

 private:
  /// Each kind includes the next one: what may be matter, what is taken as matter, matter.
  static constexpr std::size_t kKinds = 3;
  struct KindRange {
    std::size_t first;
    std::size_t end;
  };
  /// Towards a light, in voxels; `radius` at its end.
  struct Cone {
    Eigen::Vector3d from;
    Eigen::Vector3d to;
    double radius;
  };
  /// What is sure of everything in a cone without casting rays.
  struct Sure {
    double begin;  ///< the cone is clear up to here
    KindRange undecided;
  };
  [[nodiscard]] Sure decide(const Cone& cone) const;
  /// How many of the kinds are in the way: those before `undecided` are, those after it do not count.
  /// @param begin  where on the line to begin, 0..1
  [[nodiscard]] std::size_t cast(const Eigen::Vector3d& from, const Eigen::Vector3d& to,
                                 double begin, KindRange undecided) const;
  /// How far along its line the cone is surely clear of a kind; 1: all of it.
  [[nodiscard]] double clear_until(const Cone& cone, std::size_t kind) const;
  /// Whether a kind surely fills some section of the cone.
  [[nodiscard]] bool is_filled(const Cone& cone, double begin, std::size_t kind) const;

  VoxelGrid grid_;
  int n_rays_;
  std::vector<std::uint8_t> kinds_;  ///< of how many kinds each voxel is
  std::array<std::vector<std::uint8_t>, kKinds>
      distance_;  ///< to the nearest of a kind; 0: itself
  /// From the nearest voxel that is not of it, and from the grid's sides; 0: itself.
  std::array<std::vector<std::uint8_t>, kKinds> depth_;
};

}  // namespace haarlight::relight
