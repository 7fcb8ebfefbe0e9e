// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include <Eigen/Core>

#include "haarlight/relight/shadow/plane_frame.h"

/// @file
/// A regular grid of cubic voxels over a shadow plane, in the plane's own frame: x along its u, y
/// along its v, z the distance from the plane towards the lights, mm. Pure.

namespace haarlight::relight {

struct VoxelGrid {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< world position of (0, 0, 0) mm
  std::array<Eigen::Vector3d, 3> axes{Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitY(),
                                      Eigen::Vector3d::UnitZ()};  ///< orthonormal, world
  Eigen::Vector3d low = Eigen::Vector3d::Zero();  ///< lower corner, mm in the frame
  double voxel_mm = 1.0;
  int nx = 0;
  int ny = 0;
  int nz = 0;

  [[nodiscard]] std::size_t size() const {
    return static_cast<std::size_t>(nx) * static_cast<std::size_t>(ny) *
           static_cast<std::size_t>(nz);
  }
  /// Index of voxel (x, y, z); x varies fastest.
  [[nodiscard]] std::size_t index(int x, int y, int z) const {
    return (static_cast<std::size_t>(z) * static_cast<std::size_t>(ny) +
            static_cast<std::size_t>(y)) *
               static_cast<std::size_t>(nx) +
           static_cast<std::size_t>(x);
  }
  /// World point of grid coordinates: voxel (i, j, k) is the cube from (i, j, k) to (i + 1, ...).
  [[nodiscard]] Eigen::Vector3d world_of(const Eigen::Vector3d& at) const;
  [[nodiscard]] Eigen::Vector3d world_of(double x, double y, double z) const {
    return world_of(Eigen::Vector3d(x, y, z));
  }
  /// Grid coordinates of a world point.
  [[nodiscard]] Eigen::Vector3d grid_of(const Eigen::Vector3d& world) const;
  /// mm over the plane of the lower side of layer k (or of any height between layers).
  [[nodiscard]] double height_of(double z) const { return low.z() + z * voxel_mm; }
};

/// A box over the plane, mm in the plane's frame.
struct PlaneBox {
  Eigen::Vector3d low = Eigen::Vector3d::Zero();
  Eigen::Vector3d high = Eigen::Vector3d::Zero();
};

/// The grid of cubes of this size that covers a box, one voxel wider where it does not divide it.
/// @param side  1 or -1: the side of the plane, along its normal, that the lights are on
/// @throws ContractViolation  an empty box, a size of zero
[[nodiscard]] VoxelGrid make_voxel_grid(const PlaneFrame& frame, double side,
                                        const PlaneBox& box, double voxel_mm);

}  // namespace haarlight::relight
