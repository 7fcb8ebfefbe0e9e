// SPDX-License-Identifier: Apache-2.0
/// @file
/// Pictures by projecting cells against those of rays and the cube's closed form; and a wrong order,
/// which the witness has to notice.

#include "render/volume/cell_projection.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "tests/render/volume/volume_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using test::Transfer;

constexpr double kExact = 1e-12;

TEST(CellProjection, IsExactInCellsOfEveryType) {
  for (const CellType type : test::kAllTypes) {
    double worst = 0.0;
    double apart = 0.0;
    for (const std::size_t n : {1U, 3U}) {
      VolumeScene scene = test::scene_of(test::cube_of(type, n));
      for (const Transfer transfer :
           {Transfer::hills, Transfer::spikes, Transfer::nearly_constant}) {
        for (const Glow glow : {Glow::chromaticity, Glow::own}) {
          scene.glow = glow;
          test::set_transfer(transfer, scene);
          for (const double pixel_mm : {0.0, 2.0 / 37.0}) {
            test::look_at_cube({1.9, 2.2, 3.1}, 37, scene);
            scene.optics.pixel_mm = pixel_mm;
            const test::ProjectedPicture picture = test::project(scene);
            worst = std::max(worst, test::error_of_cube(scene, picture.pixels));
            apart = std::max(apart, test::difference(picture.pixels, test::render(scene)));
            EXPECT_EQ(picture.counts.violations, 0U);
          }
        }
      }
    }
    std::printf("%s: largest error %.2g, off the rays' by %.2g\n",
                std::string(shape_of(type).name).c_str(), worst, apart);
    EXPECT_LE(worst, kExact) << shape_of(type).name;
    EXPECT_LE(apart, kExact) << shape_of(type).name;
  }
}

TEST(CellProjection, ContoursAreThoseOfRays) {
  for (const CellType type : test::kAllTypes) {
    VolumeScene scene = test::scene_of(test::cube_of(type, 3));
    scene.contour_field = scene.density_field;
    // A value of nodes, too: a surface through corners of cells is met once.
    scene.contours = {{.value = 0.2, .colour = {0.9, 0.5, 0.1}, .opacity = 0.4},
                      {.value = 0.5, .colour = {0.1, 0.5, 0.9}, .opacity = 0.3},
                      {.value = 13.0 / 18.0, .opacity = 0.2}};
    for (const double pixel_mm : {0.0, 0.05}) {
      test::look_at_cube({1.9, 2.2, 3.1}, 40, scene);
      scene.optics.pixel_mm = pixel_mm;
      const test::ProjectedPicture picture = test::project(scene);
      EXPECT_LE(test::difference(picture.pixels, test::render(scene)), kExact)
          << shape_of(type).name;
      EXPECT_EQ(picture.counts.violations, 0U);
    }
  }
}

TEST(CellProjection, FieldsPerCellClippingAndBackgroundAreThoseOfRays) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(3));
  scene.colour_field = {.name = "number", .is_per_cell = true, .values = {}};
  for (std::size_t i = 0; i < scene.mesh.n_cells(); ++i) {
    scene.colour_field.values.push_back(static_cast<double>(i % 7) / 7.0);
  }
  scene.background.colour = {0.2, 0.4, 0.1};
  scene.optics.near_mm = 3.1;
  scene.optics.far_mm = 3.9;
  test::look_at_cube({1.9, 2.2, 3.1}, 40, scene);
  EXPECT_LE(test::difference(test::project(scene).pixels, test::render(scene)), kExact);
}

TEST(CellProjection, TransparentCellsAreLeftOut) {
  for (const CellType type : test::kAllTypes) {
    VolumeScene scene = test::scene_of(test::cube_of(type, 4));
    test::set_transfer(Transfer::spikes, scene);
    test::look_at_cube({1.9, 2.2, 3.1}, 40, scene);
    const CellProjection projection(scene);
    EXPECT_GT(projection.n_transparent(), 0U);
    EXPECT_EQ(projection.n_transparent() + projection.order().back_to_front.size(),
              scene.mesh.n_cells());
    EXPECT_LE(test::difference(test::project(scene).pixels, test::render(scene)), kExact);
    scene.glow = Glow::own;  // what does not absorb may glow
    EXPECT_EQ(CellProjection(scene).n_transparent(), 0U);
    scene.glow = Glow::chromaticity;
    scene.contour_field = scene.density_field;
    scene.contours = {{.value = 0.5, .opacity = 0.5}};
    EXPECT_LT(CellProjection(scene).n_transparent(), projection.n_transparent());
    EXPECT_LE(test::difference(test::project(scene).pixels, test::render(scene)), kExact);
  }
}

/// The order that is right from behind.
TEST(CellProjection, TheWitnessTellsAWrongOrder) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(2));
  test::look_at_cube({1.9, 2.2, 3.1}, 40, scene);
  VisibilityOrder order = CellProjection(scene).order();
  EXPECT_EQ(test::project(scene, order).counts.violations, 0U);
  std::ranges::reverse(order.back_to_front);
  const test::ProjectedPicture wrong = test::project(scene, order);
  EXPECT_GT(wrong.counts.violations, 1000U);
  EXPECT_LT(wrong.counts.violations, wrong.counts.stretches);
  EXPECT_GT(test::difference(wrong.pixels, test::render(scene)), 1e-3);
}

/// One cell too early.
TEST(CellProjection, TheWitnessTellsASingleCell) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(3));
  test::look_at_cube({1.9, 2.2, 3.1}, 40, scene);
  VisibilityOrder order = CellProjection(scene).order();
  std::rotate(order.back_to_front.begin(), order.back_to_front.begin() + 1,
              order.back_to_front.end());  // the farthest one first
  EXPECT_GT(test::project(scene, order).counts.violations, 10U);
}

}  // namespace
}  // namespace haarlight::render
