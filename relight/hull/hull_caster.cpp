// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/hull_caster.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/parallel.h"
#include "relight/hull/voxel_walk.h"

namespace haarlight::relight {

namespace {

constexpr int kFarthest = 255;
// per side: all alike decide

/// Distances along one line of voxels that are 0 or far.
void spread_line(std::uint8_t* d, std::size_t stride, int n) {
  for (int i = 1; i < n; ++i) {
    std::uint8_t& here = d[static_cast<std::size_t>(i) * stride];
    const int before = d[static_cast<std::size_t>(i - 1) * stride];
    here = static_cast<std::uint8_t>(std::min<int>(here, std::min(before + 1, kFarthest)));
  }
  for (int i = n - 2; i >= 0; --i) {
    std::uint8_t& here = d[static_cast<std::size_t>(i) * stride];
    const int after = d[static_cast<std::size_t>(i + 1) * stride];
    here = static_cast<std::uint8_t>(std::min<int>(here, std::min(after + 1, kFarthest)));
  }
}

/// For every voxel the Chebyshev distance to the nearest one of a kind; 0: it is one.
template <class IsOfKind>
std::vector<std::uint8_t> distances_to(const VoxelGrid& grid,
                                       const std::vector<VoxelState>& states,
                                       const IsOfKind& is_of_kind) {
  std::vector<std::uint8_t> distance(states.size());
  std::transform(states.begin(), states.end(), distance.begin(), [&](VoxelState state) {
    return static_cast<std::uint8_t>(is_of_kind(state) ? 0 : kFarthest);
  });
  // Axis by axis: min_j max(d[j], |i - j|).
  const auto nx = static_cast<std::size_t>(grid.nx);
  const auto ny = static_cast<std::size_t>(grid.ny);
  const auto nz = static_cast<std::size_t>(grid.nz);
  for (std::size_t row = 0; row < ny * nz; ++row) {
    spread_line(&distance[row * nx], 1, grid.nx);
  }
  const auto widen = [](std::uint8_t* line, std::size_t stride, int n,
                        std::vector<std::uint8_t>& copy) {
    const auto size = static_cast<std::size_t>(n);
    copy.resize(size);
    for (std::size_t i = 0; i < size; ++i) {
      copy[i] = line[i * stride];
    }
    for (std::size_t i = 0; i < size; ++i) {
      std::size_t best = copy[i];
      for (std::size_t reach = 1; reach < best; ++reach) {
        std::size_t least = best;
        if (i >= reach) {
          least = std::min<std::size_t>(least, copy[i - reach]);
        }
        if (i + reach < size) {
          least = std::min<std::size_t>(least, copy[i + reach]);
        }
        best = std::min(best, std::max(least, reach));
      }
      line[i * stride] = static_cast<std::uint8_t>(best);
    }
  };
  parallel_for(nz, 1, [&](std::size_t begin, std::size_t end) {
    std::vector<std::uint8_t> copy;
    for (std::size_t z = begin; z < end; ++z) {
      for (std::size_t x = 0; x < nx; ++x) {
        widen(&distance[z * nx * ny + x], nx, grid.ny, copy);
      }
    }
  });
  parallel_for(ny, 1, [&](std::size_t begin, std::size_t end) {
    std::vector<std::uint8_t> copy;
    for (std::size_t y = begin; y < end; ++y) {
      for (std::size_t x = 0; x < nx; ++x) {
        widen(&distance[y * nx + x], nx * ny, grid.nz, copy);
      }
    }
  });
  return distance;
}

/// What is outside the grid is not matter either.
void keep_within(const VoxelGrid& grid, std::vector<std::uint8_t>& depth) {
  for (int z = 0; z < grid.nz; ++z) {
    for (int y = 0; y < grid.ny; ++y) {
      for (int x = 0; x < grid.nx; ++x) {
        const int border =
            1 + std::min({x, y, z, grid.nx - 1 - x, grid.ny - 1 - y, grid.nz - 1 - z});
        std::uint8_t& here = depth[grid.index(x, y, z)];
        here = static_cast<std::uint8_t>(std::min<int>(here, border));
      }
    }
  }
}

}  // namespace

HullCaster::HullCaster(const ShadowHull& hull, int n_rays)
    : grid_(hull.grid), n_rays_(n_rays), states_(hull.states) {
  distance_ =
      distances_to(grid_, states_, [](VoxelState state) { return state != VoxelState::empty; });
  solid_distance_ = distances_to(grid_, states_, [](VoxelState state) {
    return state == VoxelState::matter || state == VoxelState::assumed_full;
  });
  matter_depth_ = distances_to(grid_, states_,
                               [](VoxelState state) { return state != VoxelState::matter; });
  any_depth_ =
      distances_to(grid_, states_, [](VoxelState state) { return state == VoxelState::empty; });
  keep_within(grid_, matter_depth_);
  keep_within(grid_, any_depth_);
}

HullCaster::Blocked HullCaster::cast(const Eigen::Vector3d& from, const Eigen::Vector3d& to,
                                     double begin, bool is_solid_clear) const {
  Blocked blocked;
  walk_voxels(grid_, from, to, begin, [&](std::size_t i, double) {
    switch (states_[i]) {
      case VoxelState::matter:
        blocked.by_matter = true;
        return 0;
      case VoxelState::assumed_full:
        blocked.by_assumed_full = true;
        break;
      case VoxelState::assumed_empty:
        blocked.by_assumed_empty = true;
        if (is_solid_clear) {
          return 0;
        }
        break;
      case VoxelState::empty:
        break;
    }
    // Once a voxel that is assumed to be empty was met, more of them change nothing.
    const std::uint8_t reach = blocked.by_assumed_empty ? solid_distance_[i] : distance_[i];
    return std::max(1, static_cast<int>(reach));
  });
  return blocked;
}

double HullCaster::clear_until(const Cone& cone,
                               const std::vector<std::uint8_t>& distance) const {
  const auto& [from, to, radius] = cone;
  const Eigen::Vector3d direction = to - from;
  const double length = direction.norm();
  double t = 0.0;
  double end = 1.0;
  if (!clip_to_grid(grid_, from, direction, radius, t, end)) {
    return 1.0;
  }
  const std::array<int, 3> size{grid_.nx, grid_.ny, grid_.nz};
  while (t < end) {
    std::array<int, 3> cell{};
    double outside = 0.0;  // Chebyshev distance of the point to the grid
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto a = static_cast<Eigen::Index>(axis);
      const double x = from[a] + t * direction[a];
      outside = std::max({outside, -x, x - size[axis]});
      cell[axis] = std::clamp(static_cast<int>(std::floor(x)), 0, size[axis] - 1);
    }
    // Everything within `free` of the point is empty (in the Chebyshev norm, so in the Euclidean).
    const double free =
        std::max(outside, distance[grid_.index(cell[0], cell[1], cell[2])] - 1.0 - outside);
    const double step = free - radius * t;
    if (step < 0.25) {
      return t;
    }
    // Moving on by s widens the cone by radius s/length.
    t += step / (length + radius);
  }
  return 1.0;
}

bool HullCaster::is_filled(const Cone& cone, double begin,
                           const std::vector<std::uint8_t>& depth,
                           const std::vector<std::uint8_t>& distance) const {
  bool is_filled = false;
  walk_voxels(grid_, cone.from, cone.to, begin, [&](std::size_t i, double t) {
    if (depth[i] == 0) {
      return std::max(1, static_cast<int>(distance[i]));
    }
    // The cone's section reaches no further than the voxels around, all of that kind.
    is_filled = depth[i] - 1 >= cone.radius * t;
    return is_filled ? 0 : 1;
  });
  return is_filled;
}

OccluderLook HullCaster::look(const Eigen::Vector3d& point,
                              const render::SquareLight& light) const {
  const Eigen::Vector3d from = grid_.grid_of(point);
  const Eigen::Vector3d centre = grid_.grid_of(light.centre);
  const double scale = 1.0 / grid_.voxel_mm;
  const auto turn = [&](const Eigen::Vector3d& v) {
    return Eigen::Vector3d(v.dot(grid_.axes[0]), v.dot(grid_.axes[1]), v.dot(grid_.axes[2]));
  };
  const Eigen::Vector3d u = turn(light.u) * (light.width_mm * scale);
  const Eigen::Vector3d v = turn(light.v) * (light.height_mm * scale);
  const Cone cone{from, centre, 0.5 * (u.norm() + v.norm())};
  const double begin = clear_until(cone, distance_);
  if (begin >= 1.0) {
    return {};
  }
  if (is_filled(cone, begin, matter_depth_, solid_distance_)) {
    return {0.0, 0.0, 0.0};
  }
  const bool is_solid_clear = clear_until(cone, solid_distance_) >= 1.0;
  if (is_solid_clear && is_filled(cone, begin, any_depth_, distance_)) {
    return {1.0, 0.0, 1.0};
  }
  // First the outermost rays and the middle ones: a light that they all see, or none, is seen so by the
  // rest, but for what is smaller than the gaps.
  const std::array<int, 3> pilot{0, n_rays_ / 2, n_rays_ - 1};
  const auto is_pilot = [&](int i) { return std::ranges::find(pilot, i) != pilot.end(); };
  int n_cast = 0;
  std::array<int, 3> n_open{};  // past matter, what is taken as matter, what may be matter
  const auto sample = [&](bool is_first) {
    for (int j = 0; j < n_rays_; ++j) {
      for (int i = 0; i < n_rays_; ++i) {
        if ((is_pilot(i) && is_pilot(j)) != is_first) {
          continue;
        }
        const Blocked blocked = cast(
            from, centre + ((i + 0.5) / n_rays_ - 0.5) * u + ((j + 0.5) / n_rays_ - 0.5) * v,
            begin, is_solid_clear);
        const bool is_blocked = blocked.by_matter || blocked.by_assumed_full;
        ++n_cast;
        n_open[0] += blocked.by_matter ? 0 : 1;
        n_open[1] += is_blocked ? 0 : 1;
        n_open[2] += is_blocked || blocked.by_assumed_empty ? 0 : 1;
      }
    }
  };
  sample(true);
  // The bounds are the pilot's where only they are mixed.
  if (n_open[1] != 0 && n_open[1] != n_cast) {
    sample(false);
  }
  OccluderLook look;
  look.high = static_cast<double>(n_open[0]) / n_cast;
  look.value = static_cast<double>(n_open[1]) / n_cast;
  look.low = static_cast<double>(n_open[2]) / n_cast;
  return look;
}

}  // namespace haarlight::relight
