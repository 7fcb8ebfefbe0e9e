// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

#include <Eigen/Core>

#include "relight/hull/voxel_grid.h"

namespace haarlight::relight {

/// Cuts the line from + t direction to a box grown by `margin`, in grid coordinates; false if
/// nothing of [begin, end] is left.
inline bool clip_to_grid(const VoxelGrid& grid, const Eigen::Vector3d& from,
                         const Eigen::Vector3d& direction, double margin, double& begin,
                         double& end) {
  const Eigen::Vector3d size(grid.nx, grid.ny, grid.nz);
  for (int axis = 0; axis < 3; ++axis) {
    const double low = -margin;
    const double high = size[axis] + margin;
    if (direction[axis] == 0.0) {
      if (!(from[axis] >= low && from[axis] <= high)) {
        return false;
      }
      continue;
    }
    const double t0 = (low - from[axis]) / direction[axis];
    const double t1 = (high - from[axis]) / direction[axis];
    begin = std::max(begin, std::min(t0, t1));
    end = std::min(end, std::max(t0, t1));
  }
  return begin < end;
}

/// Calls visit(index) for the voxels on the line from `from` to `to` (grid coordinates), in order,
/// until it returns 0. Otherwise it returns for how many voxels in every direction nothing
/// changes (1: look at the next one).
/// @param t  where on the line to begin, 0..1
/// @param visit  also gets where on the line the voxel is met
template <class Visit>
void walk_voxels(const VoxelGrid& grid, const Eigen::Vector3d& from, const Eigen::Vector3d& to,
                 double t, const Visit& visit) {
  constexpr double kNudge = 1e-7;  // voxels past a wall, so that the next cell is the next one
  const Eigen::Vector3d direction = to - from;
  double end = 1.0;
  if (!clip_to_grid(grid, from, direction, 0.0, t, end)) {
    return;
  }
  const double nudge = kNudge / std::max(1e-300, direction.cwiseAbs().maxCoeff());
  const std::array<int, 3> size{grid.nx, grid.ny, grid.nz};
  // Of t, from one wall to the next. Infinite where the line is parallel to the walls: it never
  // meets one, and if it lies in one, infinity times 0 is no number and loses against `next`.
  std::array<double, 3> per_step{};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const double slope = direction[static_cast<Eigen::Index>(axis)];
    per_step[axis] = slope == 0.0 ? std::numeric_limits<double>::infinity() : 1.0 / slope;
  }
  t += nudge;
  while (t < end) {
    std::array<int, 3> cell{};
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto a = static_cast<Eigen::Index>(axis);
      // Inside the grid but for rounding, so that cutting off is rounding down.
      cell[axis] = std::clamp(static_cast<int>(from[a] + t * direction[a]), 0, size[axis] - 1);
    }
    const int reach = visit(grid.index(cell[0], cell[1], cell[2]), t);
    if (reach == 0) {
      return;
    }
    double next = std::numeric_limits<double>::infinity();
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const int wall = cell[axis] + (per_step[axis] > 0.0 ? reach : 1 - reach);
      next = std::min(next, (wall - from[static_cast<Eigen::Index>(axis)]) * per_step[axis]);
    }
    t = std::max(next, t) + nudge;
  }
}

}  // namespace haarlight::relight
