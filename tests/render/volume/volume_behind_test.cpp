// SPDX-License-Identifier: Apache-2.0
/// @file
/// What is behind a medium, and where the medium is: against closed forms.

#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "render/volume/volume_hash.h"
#include "render/volume/zero_of.h"
#include "tests/render/volume/volume_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Array3d;
using Eigen::Vector3d;
using test::VolumeLight;

constexpr double kExact = 1e-12;  // of light of about 1: some tens of pieces, each to rounding
constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// A picture of one depth, whose light differs from pixel to pixel.
SurfacesBehind surfaces_at(const VolumeScene& scene, double depth) {
  const int width = scene.camera.width;
  const int height = scene.camera.height;
  SurfacesBehind surfaces{.file = "behind.exr",
                          .light = Image<float>(height, width, 3),
                          .depth = Image<float>(height, width, 1),
                          .where = "scene.toml:7"};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int c = 0; c < 3; ++c) {
        surfaces.light(y, x, c) = 0.125F + 0.25F * static_cast<float>((x + 3 * y + c) % 5);
      }
      surfaces.depth(y, x) = static_cast<float>(depth);
    }
  }
  return surfaces;
}

/// The cube in cells of a type, of one colour.
VolumeScene cube_of_one_colour(CellType type) {
  VolumeScene scene = test::scene_of(type == CellType::tetrahedron ? test::cube_of_tetrahedra(4)
                                                                   : test::cube_of(type, 4));
  scene.colour = {{0.0}, {Array3d(0.5, 0.75, 1.0)}};
  return scene;
}

constexpr std::array kTypes = {CellType::tetrahedron, CellType::hexahedron, CellType::wedge,
                               CellType::pyramid, CellType::quadratic_tetrahedron};

/// One ray along z at (0.4, 0.3), which is in the cube from z = 1 to 2, and a plane across it.
/// @param depth_within  (t): the optical depth at t mm into the cube @param half  where it is ln 2
template <class Depth>
void expect_planes(VolumeScene& scene, const Depth& depth_within, double half) {
  for (const Projection projection : {Projection::parallel, Projection::perspective}) {
    test::look_along({0.4, 0.3, -1.0}, {0.0, 0.0, 1.0}, projection, scene);
    // Before all, on the near face, within a cell, between cells, on the far face, behind all, none.
    for (const double z : {0.5, 1.0, 1.125, 1.3, 1.5, 1.75, 2.0, 3.0, 1e10, kInfinity}) {
      scene.surfaces = surfaces_at(scene, z);
      const double at = scene.surfaces->depth(0, 0);  // in single precision
      const double through = std::exp(-depth_within(std::clamp(at - 1.0, 0.0, 1.0)));
      const Array3d truth =
          (1.0 - through) * Array3d(0.5, 0.75, 1.0) + through * light_behind(scene, 0, 0);
      for (const VolumeLight& found :
           {test::render(scene).front(), test::project(scene).pixels.front()}) {
        EXPECT_LE((found.light - truth).abs().maxCoeff(), kExact) << z;
        EXPECT_NEAR(found.opacity, 1.0 - through, kExact) << z;
        EXPECT_NEAR(found.depth, std::min({1.0 + half, at, kNoDepth}), kExact * found.depth)
            << z;
      }
    }
    scene.surfaces.reset();
    EXPECT_NEAR(test::render(scene).front().depth, 1.0 + half, kExact);
    EXPECT_NEAR(test::project(scene).pixels.front().depth, 1.0 + half, kExact);
  }
}

TEST(VolumeBehind, APlaneWithinAConstantMedium) {
  for (const CellType type : kTypes) {
    VolumeScene scene = cube_of_one_colour(type);
    scene.density = {{0.0}, {1.5}};
    expect_planes(
        scene, [](double t) { return 1.5 * t; }, std::numbers::ln2 / 1.5);
  }
}

TEST(VolumeBehind, APlaneWithinALinearMedium) {
  for (const CellType type : kTypes) {
    VolumeScene scene = cube_of_one_colour(type);
    scene.density = {{0.0, 1.0}, {0.0, 6.0}};  // x + 2 y + 3 z: 1 + 3 t
    expect_planes(
        scene, [](double t) { return t + 1.5 * t * t; },
        (std::sqrt(1.0 + 6.0 * std::numbers::ln2) - 1.0) / 3.0);
  }
}

TEST(VolumeBehind, WholePicturesEndAtTheirDepths) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(4));
  for (const Glow glow : {Glow::chromaticity, Glow::own}) {
    scene.glow = glow;
    test::look_at_cube({1.9, 2.2, 3.1}, 48, scene);
    scene.surfaces = surfaces_at(scene, 0.0);
    for (int y = 0; y < 48; ++y) {
      for (int x = 0; x < 48; ++x) {
        scene.surfaces->depth(y, x) = 2.0F + 0.05F * static_cast<float>((7 * x + 5 * y) % 60);
      }
    }
    const std::vector<VolumeLight> picture = test::render(scene);
    EXPECT_LE(test::difference(picture, test::project(scene).pixels), kExact);
    int n_within = 0;
    for (int y = 0; y < 48; ++y) {
      for (int x = 0; x < 48; ++x) {
        const auto [origin, direction] = test::pixel_ray(scene, x, y);
        const double depth = scene.surfaces->depth(y, x);
        const auto [enters, leaves] = test::within_cube(origin, direction);
        n_within += depth > enters && depth < leaves ? 1 : 0;
        const VolumeLight before =
            test::light_within_cube(scene, origin, direction, 0.0, depth);
        const Array3d truth = before.light + (1.0 - before.opacity) * light_behind(scene, x, y);
        const VolumeLight& found = test::pixel_of(picture, scene, x, y);
        EXPECT_LE((found.light - truth).abs().maxCoeff(), kExact) << x << ' ' << y;
        EXPECT_NEAR(found.opacity, before.opacity, kExact) << x << ' ' << y;
      }
    }
    EXPECT_GT(n_within, 150);
  }
}

TEST(VolumeBehind, HalfIsHiddenWhereTheDepthSays) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(4));
  test::look_at_cube({1.9, 2.2, 3.1}, 48, scene);
  int n_half = 0;
  int n_thin = 0;
  for (const VolumeLight& pixel : test::render(scene)) {
    n_half += pixel.depth < kNoDepth ? 1 : 0;
    n_thin += pixel.opacity > 0.0 && pixel.opacity < 0.5 ? 1 : 0;
    EXPECT_EQ(pixel.depth < kNoDepth, pixel.opacity >= 0.5);
  }
  EXPECT_GT(n_half, 300);
  EXPECT_GT(n_thin, 30);
  const std::vector<VolumeLight> picture = test::render(scene);
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 48; ++x) {
      const double depth = test::pixel_of(picture, scene, x, y).depth;
      if (depth < kNoDepth) {
        const auto [origin, direction] = test::pixel_ray(scene, x, y);
        EXPECT_NEAR(test::light_within_cube(scene, origin, direction, 0.0, depth).opacity, 0.5,
                    kExact);
      }
    }
  }
}

TEST(VolumeBehind, ASurfaceOfGlassThatHidesHalfIsWhereHalfIsHidden) {
  VolumeScene scene = cube_of_one_colour(CellType::tetrahedron);
  scene.density = {{0.0}, {0.1}};
  scene.contour_field = test::linear_field(scene.mesh);
  // (1 + 3 t)/6 = 0.4 at t = 0.4667
  scene.contours = {{.value = 0.4, .opacity = 0.6}};
  test::look_along({0.4, 0.3, -1.0}, {0.0, 0.0, 1.0}, Projection::parallel, scene);
  EXPECT_NEAR(test::render(scene).front().depth, 1.0 + 1.4 / 3.0, kExact);
  scene.surfaces = surfaces_at(scene, 1.25);  // in front of it
  const VolumeLight found = test::render(scene).front();
  EXPECT_EQ(found.depth, 1.25);
  EXPECT_NEAR(found.opacity, 1.0 - std::exp(-0.1 * 0.25), kExact);
}

TEST(VolumeBehind, ASurfaceNearerThanTheClippingPlaneLeavesNoMedium) {
  VolumeScene scene = cube_of_one_colour(CellType::hexahedron);
  scene.density = {{0.0}, {1.5}};
  test::look_along({0.4, 0.3, -1.0}, {0.0, 0.0, 1.0}, Projection::perspective, scene);
  scene.optics.near_mm = 1.6;
  scene.surfaces = surfaces_at(scene, 1.4);
  const VolumeLight found = test::render(scene).front();
  EXPECT_EQ(found.opacity, 0.0);
  EXPECT_TRUE((found.light == light_behind(scene, 0, 0)).all());
}

TEST(VolumeBehind, WhatRaysLeaveOutOfABrightSurfaceIsWithinTheErrorRequested) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(4));
  scene.density = {{0.0, 1.0}, {20.0, 20.0}};
  test::look_at_cube({1.9, 2.2, 3.1}, 32, scene);
  scene.surfaces = surfaces_at(scene, 1e10);
  for (float& value : scene.surfaces->light.pixels()) {
    value *= -1000.0F;
  }
  const std::vector<VolumeLight> exact = test::render(scene);
  const std::vector<VolumeLight> ended = test::render(scene, {.max_error = 1e-3});
  double worst = 0.0;
  for (std::size_t i = 0; i < exact.size(); ++i) {
    worst = std::max(worst, (exact[i].light - ended[i].light).abs().maxCoeff());
    EXPECT_EQ(exact[i].depth, ended[i].depth);
  }
  EXPECT_LE(worst, 1e-3);
  EXPECT_GT(worst, 0.0);
}

/// Of a background alone, and behind the medium.
void expect_background(const Background& background,
                       const std::vector<std::array<Array3d, 2>>& rows) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(2));
  test::look_at_cube({1.9, 2.2, 3.1}, 8, scene);
  const std::vector<VolumeLight> black = test::render(scene);
  scene.background = background;
  const std::vector<VolumeLight> over = test::render(scene);
  scene.density = {{0.0}, {0.0}};
  const std::vector<VolumeLight> alone = test::render(scene);
  for (std::size_t i = 0; i < alone.size(); ++i) {
    const Array3d& truth = rows.at(i / 8).at(i % 8 / 4);
    EXPECT_LE((alone[i].light - truth).abs().maxCoeff(), 1e-15) << i;
    EXPECT_EQ(alone[i].opacity, 0.0);
    EXPECT_EQ(alone[i].depth, kNoDepth);
    EXPECT_EQ(over[i].opacity, black[i].opacity);
    EXPECT_LE(
        (over[i].light - black[i].light - (1.0 - black[i].opacity) * truth).abs().maxCoeff(),
        1e-14)
        << i;
  }
}

TEST(VolumeBehind, BackgroundsAreSeenExactlyThroughWhatIsTransparent) {
  const Array3d a(0.25, 0.5, 0.75);
  const Array3d b(1.0, 2.0, 0.125);
  std::vector<std::array<Array3d, 2>> rows(8, {a, a});
  expect_background({.kind = BackgroundKind::colour, .colour = a}, rows);
  for (int y = 0; y < 8; ++y) {
    const Array3d mixed = a + (y + 0.5) / 8.0 * (b - a);
    rows[static_cast<std::size_t>(y)] = {mixed, mixed};
  }
  expect_background({.kind = BackgroundKind::gradient, .colour = a, .other = b}, rows);
  for (std::size_t y = 0; y < 8; ++y) {
    rows[y] = y < 4 ? std::array{a, b} : std::array{b, a};
  }
  expect_background({.kind = BackgroundKind::checker, .colour = a, .other = b, .square_px = 4},
                    rows);
  Background picture{.kind = BackgroundKind::picture, .picture = Image<float>(8, 8, 3)};
  for (std::size_t y = 0; y < 8; ++y) {
    rows[y] = {Array3d(0.5, 0.25, static_cast<double>(y)), Array3d(-0.5, 3.0, 1.0)};
    for (int x = 0; x < 8; ++x) {
      for (int c = 0; c < 3; ++c) {
        picture.picture(static_cast<int>(y), x, c) =
            static_cast<float>(rows[y].at(static_cast<std::size_t>(x / 4))[c]);
      }
    }
  }
  expect_background(picture, rows);
  Background grey{.kind = BackgroundKind::picture, .picture = Image<float>(8, 8, 1)};
  for (std::size_t y = 0; y < 8; ++y) {
    rows[y] = {Array3d::Constant(static_cast<double>(y)), Array3d::Constant(0.5)};
    for (int x = 0; x < 8; ++x) {
      grey.picture(static_cast<int>(y), x, 0) = x < 4 ? static_cast<float>(y) : 0.5F;
    }
  }
  expect_background(grey, rows);
}

TEST(VolumeBehind, APictureOfAnotherSizeIsRefused) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(2));
  test::look_at_cube({1.9, 2.2, 3.1}, 8, scene);
  scene.surfaces = surfaces_at(scene, 1.0);
  scene.camera.width = 9;
  try {
    static_cast<void>(test::render(scene));
    FAIL() << "it is rendered";
  } catch (const Error& error) {
    EXPECT_EQ(error.problem(), "behind.exr has 8 x 8 pixels, the picture of the volume 9 x 8");
    EXPECT_EQ(error.where(), "scene.toml:7");
    EXPECT_NE(error.hint().find("--size 8x8"), std::string::npos);
  }
}

TEST(VolumeBehind, TheHashTellsWhatHasChanged) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(2));
  const VolumeHashes before = hashes_of(scene);
  const auto expect_other = [&](bool mesh, bool looks, bool behind, bool camera) {
    const VolumeHashes after = hashes_of(scene);
    EXPECT_EQ(after.mesh != before.mesh, mesh);
    EXPECT_EQ(after.looks != before.looks, looks);
    EXPECT_EQ(after.behind != before.behind, behind);
    EXPECT_EQ(after.camera != before.camera, camera);
  };
  const VolumeScene same = scene;
  expect_other(false, false, false, false);
  scene.mesh.points[0].x() += 1e-9;
  expect_other(true, false, false, false);
  scene = same;
  std::swap(scene.mesh.nodes[0], scene.mesh.nodes[1]);
  expect_other(true, false, false, false);
  scene = same;
  scene.colour_field.values[3] += 1e-9;
  expect_other(true, false, false, false);
  scene = same;
  scene.glow = Glow::own;
  expect_other(false, true, false, false);
  scene = same;
  scene.contours = {{.value = 0.5}};
  expect_other(false, true, false, false);
  scene = same;
  scene.background.other = {0.0, 0.0, 1e-9};
  expect_other(false, false, true, false);
  scene = same;
  scene.surfaces = surfaces_at(scene, 1.0);
  expect_other(false, false, true, false);
  const std::string near = hashes_of(scene).behind;
  scene.surfaces->depth(0, 0) = 2.0F;
  EXPECT_NE(hashes_of(scene).behind, near);
  scene = same;
  scene.optics.far_mm = 3.0;
  expect_other(false, false, false, true);
}

TEST(ZeroOf, IsFoundToRoundingOfFlatAndSteepFunctions) {
  const auto expect = [](const auto& f, double low, double high, double truth) {
    int n = 0;
    const double found = zero_of(
        [&](double x) {
          ++n;
          return f(x);
        },
        {low, f(low)}, {high, f(high)}, 0.9 * low + 0.1 * high);
    EXPECT_NEAR(found, truth, 2e-15 * std::abs(truth)) << truth;
    EXPECT_LE(n, 100) << truth;
  };
  expect([](double x) { return x - 0.25; }, 0.0, 1.0, 0.25);
  expect([](double x) { return x * x - 0.5; }, 0.0, 1.0, std::sqrt(0.5));
  expect([](double x) { return std::pow(x, 30.0) - 0.5; }, 0.0, 1.0, std::pow(0.5, 1.0 / 30));
  expect([](double x) { return -std::expm1(-700.0 * x) - 0.5; }, 0.0, 1.0,
         std::numbers::ln2 / 700.0);
  expect([](double x) { return x < 0.7 ? -0.5 : 1e6 * (x - 0.7) - 0.5; }, 0.0, 1.0,
         0.7 + 0.5e-6);
  EXPECT_EQ(zero_of([](double) { return 0.0; }, {0.5, 0.0}, {0.5, 0.0}, 0.5), 0.5);
}

}  // namespace
}  // namespace haarlight::render
