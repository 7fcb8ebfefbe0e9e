// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/voxel_grid.h"

#include <algorithm>
#include <cmath>

#include "haarlight/core/error.h"

namespace haarlight::relight {

Eigen::Vector3d VoxelGrid::world_of(const Eigen::Vector3d& at) const {
  const Eigen::Vector3d mm = low + voxel_mm * at;
  return origin + mm.x() * axes[0] + mm.y() * axes[1] + mm.z() * axes[2];
}

Eigen::Vector3d VoxelGrid::grid_of(const Eigen::Vector3d& world) const {
  const Eigen::Vector3d offset = world - origin;
  const Eigen::Vector3d mm(offset.dot(axes[0]), offset.dot(axes[1]), offset.dot(axes[2]));
  return (mm - low) / voxel_mm;
}

VoxelGrid make_voxel_grid(const PlaneFrame& frame, double side, const PlaneBox& box,
                          double voxel_mm) {
  const Eigen::Vector3d extent = box.high - box.low;
  HAARLIGHT_EXPECTS(voxel_mm > 0.0 && extent.minCoeff() > 0.0, "a box and voxels with a size");
  VoxelGrid grid;
  // The plane's foot point under the origin, so that heights are those of the plane.
  grid.origin = frame.origin - frame.height_of(frame.origin) * frame.plane.n;
  grid.axes = {frame.u, frame.v, side * frame.plane.n};
  grid.low = box.low;
  grid.voxel_mm = voxel_mm;
  const auto count = [&](double mm) {
    return std::max(1, static_cast<int>(std::ceil(mm / voxel_mm - 1e-9)));
  };
  grid.nx = count(extent.x());
  grid.ny = count(extent.y());
  grid.nz = count(extent.z());
  return grid;
}

}  // namespace haarlight::relight
