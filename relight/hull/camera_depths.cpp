// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/camera_depths.h"

#include <algorithm>
#include <limits>

#include "haarlight/core/error.h"
#include "relight/hull/voxel_walk.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

/// Distances along the ray, in voxels.
struct Interval {
  double begin = std::numeric_limits<double>::infinity();
  double end = -std::numeric_limits<double>::infinity();

  [[nodiscard]] bool is_empty() const { return begin > end; }
  void add(double low, double high) {
    begin = std::min(begin, low);
    end = std::max(end, high);
  }
};

struct Met {
  Interval not_empty;
  Interval first_run;  ///< of what is taken as matter
};

/// A voxel counts with the two planes across the ray that touch its cube: at most a voxel's
/// diagonal wider than where the ray enters and leaves it.
Met follow(const ShadowHull& hull, const Vector3d& from, const Vector3d& direction) {
  constexpr double kFar = 1e5;  // voxels
  const VoxelGrid& grid = hull.grid;
  const double half = 0.5 * direction.cwiseAbs().sum();
  Met met;
  bool is_run_over = false;
  walk_voxels(grid, from, from + kFar * direction, 0.0, [&](std::size_t i, double) {
    if (hull.states[i] == VoxelState::empty) {
      is_run_over = !met.first_run.is_empty();
      return 1;
    }
    const auto nx = static_cast<std::size_t>(grid.nx);
    const auto ny = static_cast<std::size_t>(grid.ny);
    const std::size_t layer = i / (nx * ny);
    const std::size_t row = i / nx % ny;
    const Vector3d centre = Vector3d(static_cast<double>(i % nx), static_cast<double>(row),
                                     static_cast<double>(layer)) +
                            Vector3d::Constant(0.5);
    const double at = direction.dot(centre - from);
    met.not_empty.add(at - half, at + half);
    if (!is_taken_as_matter(hull.states[i])) {
      is_run_over = !met.first_run.is_empty();
    } else if (!is_run_over) {
      met.first_run.add(at - half, at + half);
    }
    return 1;
  });
  return met;
}

/// Whether a wanted pixel is nearer than three pixels: those on an outline show both.
bool is_beside(ImageView<const std::uint8_t> wanted, int y, int x) {
  constexpr int kReach = 2;
  for (int j = std::max(0, y - kReach); j <= std::min(wanted.height() - 1, y + kReach); ++j) {
    for (int i = std::max(0, x - kReach); i <= std::min(wanted.width() - 1, x + kReach); ++i) {
      if (wanted(j, i) != 0) {
        return true;
      }
    }
  }
  return false;
}

DepthRange make_range(const CameraModel& camera) {
  return {Image<float>(camera.height, camera.width, 1),
          Image<float>(camera.height, camera.width, 1)};
}

void store(const Interval& interval, double voxel_mm, int y, int x, DepthRange& range) {
  if (!interval.is_empty() && interval.begin > 0.0) {
    range.nearest(y, x) = static_cast<float>(interval.begin * voxel_mm);
    range.furthest(y, x) = static_cast<float>(interval.end * voxel_mm);
  }
}

}  // namespace

CameraDepths camera_depths(const ShadowHull& hull, const CameraModel& camera,
                           ImageView<const std::uint8_t> wanted) {
  HAARLIGHT_EXPECTS(wanted.height() == camera.height && wanted.width() == camera.width,
                    "one value per pixel of the camera");
  CameraDepths depths{make_range(camera), make_range(camera)};
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      const CameraRay ray = ray_through(camera, x + 0.5, y + 0.5);
      const Vector3d from = hull.grid.grid_of(ray.origin_world);
      const Vector3d direction =
          (hull.grid.grid_of(ray.origin_world + ray.direction_world) - from).normalized();
      const Met met = follow(hull, from, direction);
      if (wanted(y, x) == 0) {
        depths.n_elsewhere += met.first_run.is_empty() || is_beside(wanted, y, x) ? 0 : 1;
        continue;
      }
      ++depths.n_wanted;
      store(met.not_empty, hull.grid.voxel_mm, y, x, depths.possible);
      store(met.first_run, hull.grid.voxel_mm, y, x, depths.likely);
      depths.n_met += depths.possible.nearest(y, x) > 0.0F ? 1 : 0;
    }
  }
  return depths;
}

}  // namespace haarlight::relight
