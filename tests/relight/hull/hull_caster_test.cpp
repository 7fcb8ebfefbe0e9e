// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/hull_caster.h"

#include <cmath>

#include <gtest/gtest.h>

#include "core/random.h"
#include "relight/hull/voxel_walk.h"
#include "tests/relight/shadow/shadow_scene.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

/// Voxels of 2 mm, some of each kind in a few random boxes.
ShadowHull random_hull(std::uint64_t seed) {
  ShadowHull hull;
  hull.grid = make_voxel_grid(shadow_scene::ground(), 1.0,
                              {{-30.0, -20.0, 40.0}, {30.0, 30.0, 100.0}}, 2.0);
  hull.states.assign(hull.grid.size(), VoxelState::empty);
  for (std::uint64_t b = 0; b < 6; ++b) {
    const auto draw = [&](std::uint64_t i, int n) {
      return static_cast<int>(uniform_unit(hash_key(seed, b, i)) * n);
    };
    const int x0 = draw(1, hull.grid.nx - 6);
    const int y0 = draw(2, hull.grid.ny - 6);
    const int z0 = draw(3, hull.grid.nz - 6);
    const auto state = static_cast<VoxelState>(1 + draw(4, 3));
    for (int z = z0; z < z0 + 1 + draw(5, 5); ++z) {
      for (int y = y0; y < y0 + 1 + draw(6, 5); ++y) {
        for (int x = x0; x < x0 + 1 + draw(7, 5); ++x) {
          hull.states[hull.grid.index(x, y, z)] = state;
        }
      }
    }
  }
  return hull;
}

/// The definition: every voxel whose inside a ray crosses, by slabs.
struct Crossed {
  bool by_matter = false;
  bool by_full = false;
  bool by_empty = false;
};
Crossed cross(const ShadowHull& hull, const Vector3d& from, const Vector3d& to) {
  Crossed crossed;
  const VoxelGrid& grid = hull.grid;
  const Vector3d d = to - from;
  for (int z = 0; z < grid.nz; ++z) {
    for (int y = 0; y < grid.ny; ++y) {
      for (int x = 0; x < grid.nx; ++x) {
        const VoxelState state = hull.states[grid.index(x, y, z)];
        if (state == VoxelState::empty) {
          continue;
        }
        double begin = 0.0;
        double end = 1.0;
        const Vector3d low(x, y, z);
        for (int a = 0; a < 3; ++a) {
          const double t0 = (low[a] - from[a]) / d[a];
          const double t1 = (low[a] + 1.0 - from[a]) / d[a];
          begin = std::max(begin, std::min(t0, t1));
          end = std::min(end, std::max(t0, t1));
        }
        // Corners that are cut by less than the walk's nudge may go either way.
        if (end - begin > 1e-6) {
          crossed.by_matter |= state == VoxelState::matter;
          crossed.by_full |= state == VoxelState::assumed_full;
          crossed.by_empty |= state == VoxelState::assumed_empty;
        }
      }
    }
  }
  return crossed;
}

render::SquareLight random_light(std::uint64_t seed, std::uint64_t i) {
  render::SquareLight light;
  light.centre = {800.0 * (uniform_unit(hash_key(seed, i, 21)) - 0.5),
                  800.0 * (uniform_unit(hash_key(seed, i, 22)) - 0.5), 900.0};
  light.width_mm = light.height_mm = 28.0;
  return light;
}
/// A point from which the light is seen past, or through, some voxel that is not empty.
Vector3d random_point(const ShadowHull& hull, const render::SquareLight& light,
                      std::uint64_t seed, std::uint64_t i) {
  std::vector<Vector3d> filled;
  for (int z = 0; z < hull.grid.nz; ++z) {
    for (int y = 0; y < hull.grid.ny; ++y) {
      for (int x = 0; x < hull.grid.nx; ++x) {
        if (hull.states[hull.grid.index(x, y, z)] != VoxelState::empty) {
          filled.push_back(hull.grid.world_of(x + 0.5, y + 0.5, z + 0.5));
        }
      }
    }
  }
  const auto draw = [&](std::uint64_t what) { return uniform_unit(hash_key(seed, i, what)); };
  const Vector3d target =
      (filled.empty()
           ? Vector3d(0.0, 0.0, 70.0)
           : filled[static_cast<std::size_t>(draw(31) * static_cast<double>(filled.size()))]) +
      5.0 * Vector3d(draw(32) - 0.5, draw(33) - 0.5, draw(34) - 0.5);
  return target + 0.15 * draw(35) * (target - light.centre);
}

TEST(HullCaster, CountsTheRaysThatTheDefinitionBlocks) {
  constexpr int kRays = 3;
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    const ShadowHull hull = random_hull(seed);
    const HullCaster caster(hull, kRays);
    int n_mixed = 0;
    for (std::uint64_t i = 0; i < 60; ++i) {
      const render::SquareLight light = random_light(seed, i);
      const Vector3d point = random_point(hull, light, seed, i);
      const OccluderLook found = caster.look(point, light);
      OccluderLook expected{0.0, 0.0, 0.0};
      for (int a = 0; a < kRays; ++a) {
        for (int b = 0; b < kRays; ++b) {
          const Vector3d to = light.centre + ((a + 0.5) / kRays - 0.5) * 28.0 * light.u +
                              ((b + 0.5) / kRays - 0.5) * 28.0 * light.v;
          const Crossed crossed = cross(hull, hull.grid.grid_of(point), hull.grid.grid_of(to));
          expected.high += crossed.by_matter ? 0.0 : 1.0 / (kRays * kRays);
          expected.value += crossed.by_matter || crossed.by_full ? 0.0 : 1.0 / (kRays * kRays);
          expected.low += crossed.by_matter || crossed.by_full || crossed.by_empty
                              ? 0.0
                              : 1.0 / (kRays * kRays);
        }
      }
      EXPECT_NEAR(found.value, expected.value, 1e-12) << seed << ' ' << i;
      EXPECT_NEAR(found.high, expected.high, 1e-12) << seed << ' ' << i;
      EXPECT_NEAR(found.low, expected.low, 1e-12) << seed << ' ' << i;
      n_mixed += expected.low < 1.0 ? 1 : 0;
    }
    EXPECT_GT(n_mixed, 30) << seed;  // the rays meet something
  }
}

TEST(HullCaster, ALightCalledClearIsClear) {
  // 20 x 20 rays against the pyramid test: where any is blocked the light is not all visible.
  for (std::uint64_t seed = 11; seed <= 13; ++seed) {
    const ShadowHull hull = random_hull(seed);
    const HullCaster dense(hull, 20);
    const HullCaster caster(hull, 20);
    for (std::uint64_t i = 0; i < 300; ++i) {
      const render::SquareLight light = random_light(seed, i);
      const Vector3d point = random_point(hull, light, seed, i);
      const OccluderLook found = caster.look(point, light);
      EXPECT_LE(found.low, found.value);
      EXPECT_LE(found.value, found.high);
      render::SquareLight quarter = light;  // its own corner, where the pilot rays do not reach
      quarter.width_mm = quarter.height_mm = 7.0;
      quarter.centre += 10.5 * light.u + 10.5 * light.v;
      if (found.low == 1.0 && dense.look(point, quarter).low < 1.0) {
        // Only the pilot's gaps may hide it: 9 rays that agree, never the pyramid test.
        EXPECT_GT(dense.look(point, quarter).low, 0.0);
      }
    }
  }
}

TEST(HullCaster, WhatIsSaidOfManyLightsHoldsForEach) {
  int n_hidden = 0;
  int n_clear = 0;
  for (std::uint64_t seed = 0; seed < 4; ++seed) {
    ShadowHull hull = random_hull(seed);
    // A thick part, so that whole blocks of lights are hidden as well.
    for (int z = 8; z < 20; ++z) {
      for (int y = 4; y < 20; ++y) {
        for (int x = 4; x < 22; ++x) {
          hull.states[hull.grid.index(x, y, z)] = VoxelState::matter;
        }
      }
    }
    const HullCaster caster(hull);
    for (std::uint64_t i = 0; i < 400; ++i) {
      render::SquareLight light = random_light(seed, i);
      // Every second one looks past the hull.
      const Vector3d point =
          random_point(hull, light, seed, i) + (i % 2 == 0 ? 0.0 : 25.0) * Vector3d::UnitX();
      const Vector3d centre = light.centre;
      const double radius = 20.0 + 90.0 * uniform_unit(hash_key(seed, i, 41));
      const auto all = caster.look_at_all(point, centre, radius);
      if (!all) {
        continue;
      }
      (all->value > 0.0 ? n_clear : n_hidden) += 1;
      for (std::uint64_t k = 0; k < 8; ++k) {
        const double angle = 0.785 * static_cast<double>(k);
        light.centre =
            centre + (radius - 20.0) * Vector3d(std::cos(angle), std::sin(angle), 0.0);
        const OccluderLook one = caster.look(point, light);
        EXPECT_EQ(one.value, all->value);
        EXPECT_EQ(one.low, all->low);
        EXPECT_EQ(one.high, all->high);
      }
    }
  }
  EXPECT_GT(n_hidden, 20);
  EXPECT_GT(n_clear, 20);
}

TEST(HullCaster, HalfALightBehindAnEdge) {
  // A half space of voxels x > 0 at z = 50: the light's visible fraction is that of eq. (1)'s
  // penumbra, to one ray of n in the direction across the edge.
  ShadowHull hull;
  hull.grid = make_voxel_grid(shadow_scene::ground(), 1.0,
                              {{-60.0, -60.0, 50.0}, {60.0, 60.0, 51.0}}, 1.0);
  hull.states.assign(hull.grid.size(), VoxelState::empty);
  for (int y = 0; y < hull.grid.ny; ++y) {
    for (int x = 60; x < hull.grid.nx; ++x) {
      hull.states[hull.grid.index(x, y, 0)] = VoxelState::matter;
    }
  }
  const HullCaster caster(hull, 8);
  render::SquareLight light;
  light.centre = {0.0, 0.0, 900.0};
  light.width_mm = light.height_mm = 28.0;
  for (double x = -1.5; x <= 1.5; x += 0.1) {
    // From (x, 0, 0) the edge at height 50..51 is seen against the light at x + (0 - x) 900/50.
    const double edge = x - x * 900.0 / 50.5;
    const double visible = std::clamp((edge + 14.0) / 28.0, 0.0, 1.0);
    EXPECT_NEAR(caster.look({x, 0.3, 0.0}, light).value, visible, 1.0 / 8.0 + 0.02) << x;
  }
}

TEST(HullCaster, AnEmptyHullHidesNothing) {
  ShadowHull hull = random_hull(5);
  std::fill(hull.states.begin(), hull.states.end(), VoxelState::empty);
  const HullCaster caster(hull);
  for (std::uint64_t i = 0; i < 50; ++i) {
    const render::SquareLight light = random_light(5, i);
    EXPECT_EQ(caster.look(random_point(hull, light, 5, i), light).low, 1.0);
  }
}

TEST(HullCaster, OddRaysEnd) {
  const ShadowHull hull = random_hull(6);
  const HullCaster caster(hull);
  render::SquareLight light = random_light(6, 0);
  // Along an axis, along the grid's walls, from within a voxel, to the point itself.
  for (const Vector3d& point :
       {Vector3d(light.centre.x(), light.centre.y(), 0.0), hull.grid.world_of(3.0, 4.0, 5.0),
        hull.grid.world_of(0.0, 0.0, 0.0), light.centre, Vector3d(1e9, -1e9, 1e9)}) {
    const OccluderLook look = caster.look(point, light);
    EXPECT_GE(look.low, 0.0);
    EXPECT_LE(look.high, 1.0);
  }
}

}  // namespace
}  // namespace haarlight::relight
