// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/carve.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <string>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "relight/hull/kept_pictures.h"
#include "relight/hull/shadow_hull.h"
#include "tests/relight/shadow/shadow_scene.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using shadow_scene::blank_picture;
using shadow_scene::ceiling;
using shadow_scene::ground;
using shadow_scene::plate_shadow;

// The plate of shadow_scene.h: x -40..25, y -15..40, at z = 100, without thickness.
constexpr double kPlateZ = 100.0;

/// The plate's shadow pictures, made once for each number of lights.
std::vector<SamplingPlane> planes_of(const std::vector<render::SquareLight>& lights) {
  static std::map<std::size_t, std::vector<Visibility>> made;
  const PlaneFrame frame = ground();
  std::vector<Visibility>& pictures = made[lights.size()];
  while (pictures.size() < lights.size()) {
    pictures.push_back(plate_shadow(frame, lights[pictures.size()]));
  }
  return {{frame, [&pictures](int k) { return pictures[static_cast<std::size_t>(k)]; }, {}}};
}

VoxelGrid grid_around_plate() {
  return make_voxel_grid(ground(), 1.0, {{-60.0, -40.0, 60.0}, {50.0, 60.0, 140.0}}, 2.0);
}

/// Whether lights of this ceiling leave a point in the plate's umbra from all their centres: the
/// largest hull that the centres' rays allow.
bool is_in_hull(const Vector3d& p, const std::vector<render::SquareLight>& lights,
                double margin) {
  for (const render::SquareLight& light : lights) {
    const double t = (kPlateZ - p.z()) / (light.centre.z() - p.z());
    const Vector3d at = p + t * (light.centre - p);
    if (!(at.x() > -40.0 - margin && at.x() < 25.0 + margin && at.y() > -15.0 - margin &&
          at.y() < 40.0 + margin)) {
      return false;
    }
  }
  return true;
}

TEST(VoxelGrid, WorldAndGridAreInverse) {
  ShadowPlane plane;
  plane.n = Vector3d(0.1, -0.3, 1.0);
  plane.d = -20.0;
  plane.u = Vector3d(1.0, 0.0, -0.1).normalized();
  plane.v = plane.n.normalized().cross(plane.u);
  plane.origin = plane.n * (20.0 / plane.n.squaredNorm());
  plane.extent_u_mm = plane.extent_v_mm = 100.0;
  plane.texel_mm = 2.0;
  const PlaneFrame frame = make_plane_frame(plane);
  for (const double side : {1.0, -1.0}) {
    const VoxelGrid grid =
        make_voxel_grid(frame, side, {{-10.0, -20.0, 5.0}, {10.0, 20.0, 30.5}}, 2.0);
    EXPECT_EQ(grid.nx, 10);
    EXPECT_EQ(grid.ny, 20);
    EXPECT_EQ(grid.nz, 13);  // 12.75 voxels
    const Vector3d at(3.25, 7.5, 11.0);
    const Vector3d world = grid.world_of(at);
    EXPECT_LT((grid.grid_of(world) - at).norm(), 1e-12);
    EXPECT_NEAR(side * frame.height_of(world), grid.height_of(11.0), 1e-12);
  }
}

TEST(Carve, ALightThatIsSeenOnTwoPlanesCountsOnce) {
  const std::vector<render::SquareLight> lights = ceiling(8);
  std::vector<SamplingPlane> planes = planes_of(lights);
  const VoxelGrid grid = grid_around_plate();
  const CarveResult one = carve(grid, planes, lights, {});
  planes.push_back(planes[0]);
  const CarveResult two = carve(grid, planes, lights, {});
  EXPECT_EQ(two.n_lights, 64);
  int n_kept = 0;
  for (std::size_t i = 0; i < grid.size(); ++i) {
    // What is empty stops counting; lit beams of both pictures count.
    if (two.is_empty[i] == 0) {
      ++n_kept;
      ASSERT_EQ(one.is_empty[i], 0);
      ASSERT_EQ(two.n_seen[i], one.n_seen[i]);
    }
  }
  EXPECT_GT(n_kept, 1000);
}

TEST(Carve, KeepsThePlateAndItsUmbraAndNothingElse) {
  const std::vector<render::SquareLight> lights = ceiling(8);
  const std::vector<SamplingPlane> planes = planes_of(lights);
  const VoxelGrid grid = grid_around_plate();
  const CarveResult found = carve(grid, planes, lights, {});
  EXPECT_EQ(found.n_lights, 64);
  // A texel (4 mm) of the plane is 3.6 mm at the plate, half a voxel 1 mm; a penumbra is as
  // sharp as its middle.
  constexpr double kMargin = 2.5;
  int n_kept = 0;
  for (int z = 0; z < grid.nz; ++z) {
    for (int y = 0; y < grid.ny; ++y) {
      for (int x = 0; x < grid.nx; ++x) {
        const Vector3d at = grid.world_of(x + 0.5, y + 0.5, z + 0.5);
        const std::size_t i = grid.index(x, y, z);
        if (is_in_hull(at, lights, -kMargin)) {
          ASSERT_EQ(found.is_empty[i], 0) << at.transpose();
          ASSERT_EQ(found.n_seen[i], 64);
          ++n_kept;
        }
        // At least four lights must see past it: half a row of them, half a step (60 mm, 40 mm over
        // the plate 3 mm) further than the first.
        if (!is_in_hull(at, lights, kMargin + 4.0)) {
          ASSERT_EQ(found.is_empty[i], 1) << at.transpose();
        }
      }
    }
  }
  EXPECT_GT(n_kept, 5000);
}

TEST(KeepPictures, AsksOncePerLightAndRoundsToABit) {
  const std::vector<render::SquareLight> lights = ceiling(4);
  const std::vector<SamplingPlane> planes = planes_of(lights);
  std::vector<int> n_requests(lights.size());
  const VisibilitySource counting = [&](int k) {
    ++n_requests[static_cast<std::size_t>(k)];
    Visibility picture = planes[0].visibility(k);
    picture.known(3, 5) = 0;
    picture.value(4, 6) = 1.5F;
    return picture;
  };
  const std::vector<SamplingPlane> counted{{planes[0].frame, counting, {}}};
  const Visibility original = planes[0].visibility(0);
  const std::size_t bytes = original.value.pixels().size();
  // Room for all but the last two, which are requested at every pass.
  const std::vector<SamplingPlane> kept =
      keep_pictures(counted, (lights.size() - 2) * bytes + bytes / 2);
  for (int pass = 0; pass < 3; ++pass) {
    for (std::size_t k = 0; k < lights.size(); ++k) {
      const Visibility picture = kept[0].visibility(static_cast<int>(k));
      const Visibility exact = counting(static_cast<int>(k));
      --n_requests[k];
      ASSERT_EQ(picture.known(3, 5), 0);
      ASSERT_EQ(picture.value(4, 6), 1.0F);
      for (std::size_t i = 0; i < bytes; ++i) {
        ASSERT_EQ(picture.known.pixels()[i], exact.known.pixels()[i]);
        if (exact.known.pixels()[i] != 0) {
          ASSERT_NEAR(picture.value.pixels()[i], std::min(exact.value.pixels()[i], 1.0F),
                      0.5F / 254.0F + 1e-6F);
        }
      }
    }
  }
  for (std::size_t k = 0; k < lights.size(); ++k) {
    EXPECT_EQ(n_requests[k], k + 2 < lights.size() ? 1 : 3) << k;
  }
}

TEST(Carve, DoesNotDependOnMemory) {
  const std::vector<render::SquareLight> lights = ceiling(8);
  const VoxelGrid grid = grid_around_plate();
  CarveOptions one;
  one.memory_bytes = 1;  // one picture at a time
  const CarveResult a = carve(grid, planes_of(lights), lights, {}, one);
  const CarveResult b = carve(grid, planes_of(lights), lights, {});
  EXPECT_EQ(a.is_empty, b.is_empty);
  for (std::size_t i = 0; i < a.is_empty.size(); ++i) {
    if (a.is_empty[i] == 0) {
      ASSERT_EQ(a.n_seen[i], b.n_seen[i]);
      ASSERT_EQ(a.lit_evidence[i], b.lit_evidence[i]);
    }
  }
}

TEST(Carve, ThreeBrightFramesCarveNothing) {
  const std::vector<render::SquareLight> lights = ceiling(8);
  const PlaneFrame frame = ground();
  const auto lying = [&](int k) {  // an open door: these frames show no shadow at all
    Visibility v = planes_of(lights)[0].visibility(k);
    if (k == 4 || k == 30 || k == 50) {
      std::ranges::fill(v.value.pixels(), 1.0F);
    }
    return v;
  };
  const std::vector<SamplingPlane> planes{{frame, lying, {}}};
  const VoxelGrid grid = grid_around_plate();
  const CarveResult honest = carve(grid, planes_of(lights), lights, {});
  const CarveResult found = carve(grid, planes, lights, {});
  std::size_t n_matter = 0;
  std::size_t n_lost = 0;
  for (std::size_t i = 0; i < grid.size(); ++i) {
    n_matter += honest.is_empty[i] == 0 ? 1U : 0U;
    n_lost += honest.is_empty[i] == 0 && found.is_empty[i] != 0 ? 1U : 0U;
  }
  // Only voxels that honest beams all but carved: three beams are worth 9 of the 12 needed.
  EXPECT_LT(static_cast<double>(n_lost), 0.1 * static_cast<double>(n_matter));
  const auto centre = grid.grid_of({-8.0, 12.0, kPlateZ});
  EXPECT_EQ(
      found.is_empty[grid.index(static_cast<int>(centre.x()), static_cast<int>(centre.y()),
                                static_cast<int>(centre.z()))],
      0);
}

TEST(Carve, NoiseAndUnknownValuesAreBorne) {
  const std::vector<render::SquareLight> lights = ceiling(8);
  const PlaneFrame frame = ground();
  const auto odd = [&](int k) {
    Visibility v = planes_of(lights)[0].visibility(k);
    for (std::size_t i = 0; i < v.value.pixels().size(); ++i) {
      v.value.pixels()[i] += static_cast<float>(
          0.03 * standard_normal(hash_key(static_cast<std::uint64_t>(k), i)));
    }
    v.value(3, 3) = std::numeric_limits<float>::quiet_NaN();
    v.value(4, 4) = std::numeric_limits<float>::infinity();
    for (int y = 0; y < 10; ++y) {
      v.known(y, 50) = 0;
    }
    return v;
  };
  const std::vector<SamplingPlane> planes{{frame, odd, {}}};
  const VoxelGrid grid = grid_around_plate();
  const CarveResult found = carve(grid, planes, lights, {});
  const CarveResult ideal = carve(grid, planes_of(lights), lights, {});
  std::size_t n_differ = 0;
  std::size_t n_matter = 0;
  for (std::size_t i = 0; i < grid.size(); ++i) {
    n_matter += ideal.is_empty[i] == 0 ? 1U : 0U;
    n_differ += found.is_empty[i] != ideal.is_empty[i] ? 1U : 0U;
  }
  // Noise moves the edge of 1/2 by 3 % of a penumbra, far less than a voxel.
  EXPECT_LT(static_cast<double>(n_differ), 0.1 * static_cast<double>(n_matter));
}

TEST(Carve, ATiltedPlaneTellsTheSame) {
  // The same plane described with its picture turned: a grid over the first, pictures of the second.
  const std::vector<render::SquareLight> lights = ceiling(8);
  ShadowPlane plane;
  plane.u = Vector3d(std::numbers::sqrt2 / 2, std::numbers::sqrt2 / 2, 0.0);
  plane.v = Vector3d(-std::numbers::sqrt2 / 2, std::numbers::sqrt2 / 2, 0.0);
  plane.extent_u_mm = plane.extent_v_mm = 560.0;
  plane.texel_mm = 4.0;
  const PlaneFrame turned = make_plane_frame(plane);
  const std::vector<SamplingPlane> planes{
      {turned,
       [&](int k) { return plate_shadow(turned, lights[static_cast<std::size_t>(k)]); },
       {}}};
  const VoxelGrid grid = grid_around_plate();
  const CarveResult found = carve(grid, planes, lights, {});
  const CarveResult straight = carve(grid, planes_of(lights), lights, {});
  std::size_t n_matter = 0;
  std::size_t n_differ = 0;
  for (std::size_t i = 0; i < grid.size(); ++i) {
    n_matter += straight.is_empty[i] == 0 ? 1U : 0U;
    n_differ += found.is_empty[i] != straight.is_empty[i] ? 1U : 0U;
  }
  // Texels of another grid: edges differ by up to half a texel, on the surface only.
  EXPECT_LT(static_cast<double>(n_differ), 0.2 * static_cast<double>(n_matter));
}

TEST(BuildHull, FindsThePlatesHeight) {
  const std::vector<render::SquareLight> lights = ceiling(8);
  const ShadowHull hull = build_hull(planes_of(lights), lights, {});
  // The limited-angle cone: a part w wide is uncertain by about w/(2 tan) up and down; here
  // tan = 480/800 and w = 55 mm.
  EXPECT_GT(hull.summary.n_matter, 1000);
  EXPECT_LT(hull.summary.low_mm, kPlateZ);
  EXPECT_GT(hull.summary.high_mm, kPlateZ);
  EXPECT_GT(hull.summary.low_mm, kPlateZ - 60.0);
  EXPECT_LT(hull.summary.high_mm, kPlateZ + 60.0);
  EXPECT_EQ(hull.summary.n_lights, 64);
  HullOptions known;
  known.highest_mm = 105.0;
  const ShadowHull flat = build_hull(planes_of(lights), lights, {}, known);
  EXPECT_GT(flat.summary.n_matter, 1000);
  // All of the plane is seen. Were the answer asked of more lights than there are, all of it would
  // only be assumed.
  EXPECT_EQ(flat.summary.n_assumed_full, 0);
  known.surely_seen = 1.1;
  const ShadowHull doubted = build_hull(planes_of(lights), lights, {}, known);
  EXPECT_EQ(doubted.summary.n_matter, 0);
  EXPECT_EQ(doubted.summary.n_assumed_full, flat.summary.n_matter);
  EXPECT_LE(flat.summary.high_mm, 105.0 + flat.grid.voxel_mm);
}

TEST(BuildHull, WhatManyLightsNeverSawIsNotCertain) {
  // The low ones' shadows fall beyond the plane's picture: nothing says whether the room that the
  // plate shades from all others is empty above and below it.
  std::vector<render::SquareLight> lights = ceiling(8);
  for (int i = 0; i < 40; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / 40.0;
    render::SquareLight low = lights[0];
    low.centre = {2000.0 * std::cos(angle), 2000.0 * std::sin(angle), 400.0};
    lights.push_back(low);
  }
  const ShadowHull hull = build_hull(planes_of(lights), lights, {});
  EXPECT_EQ(hull.summary.n_lights, 104);
  EXPECT_EQ(hull.summary.n_matter, 0);
  EXPECT_GT(hull.summary.n_assumed_full, 1000);
}

TEST(BuildHull, OfNothingIsEmpty) {
  const std::vector<render::SquareLight> lights = ceiling(8);
  const PlaneFrame frame = ground();
  const std::vector<SamplingPlane> planes{{frame,
                                           [&](int) {
                                             Visibility v = blank_picture(frame);
                                             std::ranges::fill(v.value.pixels(), 1.0F);
                                             std::ranges::fill(v.known.pixels(),
                                                               std::uint8_t{1});
                                             return v;
                                           },
                                           {}}};
  const ShadowHull hull = build_hull(planes, lights, {});
  EXPECT_EQ(hull.summary.n_matter, 0);
}

TEST(BuildHull, SaysWhatIsImpossible) {
  std::vector<render::SquareLight> lights = ceiling(8);
  HullOptions options;
  options.highest_mm = -1.0;
  EXPECT_THROW((void)build_hull(planes_of(lights), lights, {}, options), Error);
  HullOptions fine;
  fine.highest_mm = 120.0;
  fine.voxel_mm = 0.01;
  try {
    (void)build_hull(planes_of(lights), lights, {}, fine);
    ADD_FAILURE() << "10^12 voxels";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("0.01 mm"), std::string::npos) << error.what();
  }
  for (render::SquareLight& light : lights) {
    light.centre.z() = 0.0;  // in the plane
  }
  EXPECT_THROW((void)build_hull(planes_of(lights), lights, {}), Error);
}

TEST(BuildHull, AFootThatNobodySeesIsFilledWhereTheCameraSeesIt) {
  // A slab on the plane: its shadow is hidden under itself. The camera looks down on it.
  const std::vector<render::SquareLight> lights = ceiling(8);
  const PlaneFrame frame = ground();
  const auto is_slab = [](const Vector3d& p) {
    return std::abs(p.x()) < 20.0 && std::abs(p.y()) < 20.0;
  };
  const std::vector<SamplingPlane> planes{{frame,
                                           [&](int) {
                                             Visibility v = blank_picture(frame);
                                             for (int y = 0; y < frame.height; ++y) {
                                               for (int x = 0; x < frame.width; ++x) {
                                                 const bool is_hidden =
                                                     is_slab(frame.world_of(x + 0.5, y + 0.5));
                                                 v.known(y, x) = is_hidden ? 0 : 1;
                                                 v.value(y, x) = is_hidden ? 0.0F : 1.0F;
                                               }
                                             }
                                             return v;
                                           },
                                           {}}};
  CarvingView view;
  view.camera.width = view.camera.height = 100;
  view.camera.fx = view.camera.fy = 200.0;
  view.camera.cx = view.camera.cy = 50.0;
  view.camera.world_from_cam = look_at({0.0, -10.0, 800.0}, {0.0, 0.0, 0.0}, Vector3d::UnitY());
  view.shows_plane = Image<std::uint8_t>(100, 100, 1);
  view.shows_object = Image<std::uint8_t>(100, 100, 1);
  for (int y = 0; y < 100; ++y) {
    for (int x = 0; x < 100; ++x) {
      const CameraRay ray = ray_through(view.camera, x + 0.5, y + 0.5);
      const Vector3d p = ray.origin_world -
                         ray.origin_world.z() / ray.direction_world.z() * ray.direction_world;
      view.shows_object(y, x) = is_slab(p) ? 1 : 0;
      view.shows_plane(y, x) = is_slab(p) ? 0 : 1;
    }
  }
  const ShadowHull hull = build_hull(planes, lights, {{view}});
  EXPECT_EQ(hull.summary.n_matter, 0);
  EXPECT_GT(hull.summary.n_assumed_full, 100);
  EXPECT_GT(hull.summary.explained.n_camera_rays_filled, 0);
  // Over the middle of the slab the lowest voxel is filled, beside it none is.
  const Vector3d at = hull.grid.grid_of({1.0, 1.0, 0.5 * hull.grid.voxel_mm});
  EXPECT_EQ(hull.states[hull.grid.index(static_cast<int>(at.x()), static_cast<int>(at.y()),
                                        static_cast<int>(at.z()))],
            VoxelState::assumed_full);
}

}  // namespace
}  // namespace haarlight::relight
