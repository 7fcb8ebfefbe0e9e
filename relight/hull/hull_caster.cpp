// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/hull_caster.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/parallel.h"
#include "relight/hull/voxel_walk.h"

namespace haarlight::relight {

namespace {

constexpr std::uint8_t kFarthest = 255;
constexpr std::size_t kTaken = 1;  // the kind that the picture has

/// Of how many kinds a voxel is.
std::uint8_t n_kinds_of(VoxelState state) {
  switch (state) {
    case VoxelState::matter:
      return 3;
    case VoxelState::assumed_full:
      return 2;
    case VoxelState::assumed_empty:
      return 1;
    case VoxelState::empty:
      break;
  }
  return 0;
}

/// One more, up to the farthest. Rows of bytes, apart in memory, become vectors.
std::uint8_t one_more(std::uint8_t d) {
  return static_cast<std::uint8_t>(d + (d < kFarthest ? 1 : 0));
}

void take_least(std::uint8_t* __restrict least, const std::uint8_t* __restrict row, int n) {
  for (int x = 0; x < n; ++x) {
    least[x] = std::min(least[x], row[x]);
  }
}

/// @param near  near[x - 1] to near[x + 1] are next to row[x]
void take_one_more(std::uint8_t* __restrict row, const std::uint8_t* __restrict near, int n) {
  for (int x = 0; x < n; ++x) {
    row[x] = std::min(row[x], one_more(std::min(std::min(near[x - 1], near[x]), near[x + 1])));
  }
}

/// A voxel's distance is at most one more than that of any of its 26 neighbours: one pass from the
/// first voxel to the last with the neighbours before it, one back with those after it, are
/// exact for the Chebyshev distance [Rosenfeld68]. Time does not depend on the distances.
class DistancePass {
 public:
  DistancePass(const VoxelGrid& grid, std::vector<std::uint8_t>& distance)
      : grid_(grid),
        distance_(distance),
        nearest_(static_cast<std::size_t>(grid.nx) + 2, kFarthest) {}

  /// @param step  1: towards the last voxel, -1: back
  void run(int step) {
    const int z0 = step > 0 ? 0 : grid_.nz - 1;
    const int y0 = step > 0 ? 0 : grid_.ny - 1;
    for (int z = z0; z >= 0 && z < grid_.nz; z += step) {
      for (int y = y0; y >= 0 && y < grid_.ny; y += step) {
        std::fill(nearest_.begin(), nearest_.end(), kFarthest);
        add_row(y - step, z);
        for (int j = -1; j <= 1; ++j) {
          add_row(y + j, z - step);
        }
        widen_row(&distance_[grid_.index(0, y, z)], step);
      }
    }
  }

 private:
  /// The least of the rows so far, voxel by voxel; nearest_[x + 1] is that of voxel x.
  void add_row(int y, int z) {
    if (y >= 0 && z >= 0 && y < grid_.ny && z < grid_.nz) {
      take_least(&nearest_[1], &distance_[grid_.index(0, y, z)], grid_.nx);
    }
  }

  void widen_row(std::uint8_t* row, int step) {
    const int n = grid_.nx;
    take_one_more(row, &nearest_[1], n);
    int before = kFarthest;
    for (int i = 0, x = step > 0 ? 0 : n - 1; i < n; ++i, x += step) {
      before = std::min<int>(row[x], before + 1);
      row[x] = static_cast<std::uint8_t>(before);
    }
  }

  const VoxelGrid& grid_;
  std::vector<std::uint8_t>& distance_;
  std::vector<std::uint8_t> nearest_;
};

/// For every voxel the Chebyshev distance to the nearest one of a kind; 0: it is one.
template <class IsOne>
std::vector<std::uint8_t> distances_to(const VoxelGrid& grid,
                                       const std::vector<std::uint8_t>& kinds,
                                       const IsOne& is_one) {
  std::vector<std::uint8_t> distance(kinds.size());
  std::transform(kinds.begin(), kinds.end(), distance.begin(), [&](std::uint8_t n) {
    return static_cast<std::uint8_t>(is_one(n) ? 0 : kFarthest);
  });
  DistancePass pass(grid, distance);
  pass.run(1);
  pass.run(-1);
  return distance;
}

/// What is outside the grid is of no kind.
void keep_within(const VoxelGrid& grid, std::vector<std::uint8_t>& depth) {
  const auto border = [](int i, int n) {
    return static_cast<std::uint8_t>(std::min<int>(kFarthest, 1 + std::min(i, n - 1 - i)));
  };
  std::vector<std::uint8_t> in_row(static_cast<std::size_t>(grid.nx));
  for (int z = 0; z < grid.nz; ++z) {
    for (int y = 0; y < grid.ny; ++y) {
      const std::uint8_t of_row = std::min(border(y, grid.ny), border(z, grid.nz));
      for (int x = 0; x < grid.nx; ++x) {
        in_row[static_cast<std::size_t>(x)] = std::min(of_row, border(x, grid.nx));
      }
      take_least(&depth[grid.index(0, y, z)], in_row.data(), grid.nx);
    }
  }
}

}  // namespace

HullCaster::HullCaster(const ShadowHull& hull, int n_rays)
    : grid_(hull.grid), n_rays_(n_rays), kinds_(hull.states.size()) {
  std::transform(hull.states.begin(), hull.states.end(), kinds_.begin(), n_kinds_of);
  parallel_for(2 * kKinds, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t table = begin; table < end; ++table) {
      const std::size_t kind = table / 2;
      if (table % 2 == 0) {
        distance_[kind] =
            distances_to(grid_, kinds_, [kind](std::uint8_t kinds) { return kinds > kind; });
      } else {
        depth_[kind] =
            distances_to(grid_, kinds_, [kind](std::uint8_t kinds) { return kinds <= kind; });
        keep_within(grid_, depth_[kind]);
      }
    }
  });
}

std::size_t HullCaster::cast(const Eigen::Vector3d& from, const Eigen::Vector3d& to,
                             double begin, KindRange undecided) const {
  std::size_t met = undecided.first;
  walk_voxels(grid_, from, to, begin, [&](std::size_t i, double) {
    met = std::max<std::size_t>(met, kinds_[i]);
    // Only a kind that was not met yet changes anything.
    return met >= undecided.end ? 0 : std::max(1, static_cast<int>(distance_[met][i]));
  });
  return std::min(met, undecided.end);
}

double HullCaster::clear_until(const Cone& cone, std::size_t kind) const {
  const std::vector<std::uint8_t>& distance = distance_[kind];
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
      cell[axis] = std::clamp(static_cast<int>(x), 0, size[axis] - 1);
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

bool HullCaster::is_filled(const Cone& cone, double begin, std::size_t kind) const {
  bool is_filled = false;
  walk_voxels(grid_, cone.from, cone.to, begin, [&](std::size_t i, double t) {
    const int depth = depth_[kind][i];
    if (depth == 0) {
      return std::max(1, static_cast<int>(distance_[kind][i]));
    }
    // The cone's section reaches no further than the voxels around, all of that kind.
    is_filled = depth - 1 >= cone.radius * t;
    return is_filled ? 0 : 1;
  });
  return is_filled;
}

HullCaster::Sure HullCaster::decide(const Cone& cone) const {
  Sure sure{clear_until(cone, 0), {0, 0}};
  if (sure.begin < 1.0) {
    KindRange& undecided = sure.undecided;
    undecided.end = clear_until(cone, 1) >= 1.0 ? 1 : clear_until(cone, 2) >= 1.0 ? 2 : 3;
    for (std::size_t kind = undecided.end; kind > 0 && undecided.first == 0; --kind) {
      undecided.first = is_filled(cone, sure.begin, kind - 1) ? kind : 0;
    }
  }
  return sure;
}

std::optional<OccluderLook> HullCaster::look_at_all(const Eigen::Vector3d& point,
                                                    const Eigen::Vector3d& centre,
                                                    double radius_mm) const {
  const KindRange undecided =
      decide({grid_.grid_of(point), grid_.grid_of(centre), radius_mm / grid_.voxel_mm})
          .undecided;
  if (undecided.first < undecided.end) {
    return std::nullopt;
  }
  const auto open = [&](std::size_t kind) { return kind < undecided.first ? 0.0 : 1.0; };
  return OccluderLook{open(kTaken), open(0), open(2)};
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
  const auto [begin, undecided] = decide(cone);
  // Of each kind: the fraction of the light that is seen past it.
  std::array<double, kKinds> open{1.0, 1.0, 1.0};
  std::fill_n(open.begin(), undecided.first, 0.0);
  // First the outermost rays and the middle ones: a light that they all see, or none, is seen so
  // by the rest, but for what is smaller than the gaps.
  const std::array<int, 3> pilot{0, n_rays_ / 2, n_rays_ - 1};
  const auto is_pilot = [&](int i) { return std::ranges::find(pilot, i) != pilot.end(); };
  int n_cast = 0;
  std::array<int, kKinds> n_open{};
  const auto sample = [&, begin = begin, undecided = undecided](bool is_first) {
    for (int j = 0; j < n_rays_; ++j) {
      for (int i = 0; i < n_rays_; ++i) {
        if ((is_pilot(i) && is_pilot(j)) != is_first) {
          continue;
        }
        const Eigen::Vector3d to =
            centre + ((i + 0.5) / n_rays_ - 0.5) * u + ((j + 0.5) / n_rays_ - 0.5) * v;
        ++n_cast;
        for (std::size_t kind = cast(from, to, begin, undecided); kind < undecided.end;
             ++kind) {
          ++n_open[kind];
        }
      }
    }
  };
  if (undecided.first < undecided.end) {
    sample(true);
    // The bounds are the pilot's where only they are mixed.
    if (undecided.first <= kTaken && kTaken < undecided.end && n_open[kTaken] != 0 &&
        n_open[kTaken] != n_cast) {
      sample(false);
    }
    for (std::size_t kind = undecided.first; kind < undecided.end; ++kind) {
      open[kind] = static_cast<double>(n_open[kind]) / n_cast;
    }
  }
  return {open[kTaken], open[0], open[2]};
}

}  // namespace haarlight::relight
