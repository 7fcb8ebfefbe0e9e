// SPDX-License-Identifier: Apache-2.0
/// @file
/// Cells smaller than a pixel: their light is not lost, and is where the exact picture seen through the
/// same kernel has it; and the case in which they are known to be wrong.

#include "render/volume/cell_splat.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "render/volume/cell_projection.h"
#include "tests/render/volume/volume_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Array3d;
using Eigen::Vector3d;
using test::VolumeLight;

constexpr int kSide = 24;
constexpr int kFine = 9;  ///< exact rays in each direction of a pixel

/// The cube, about ten pixels wide.
VolumeScene far_cube(CellMesh mesh, double extinction) {
  VolumeScene scene = test::scene_of(std::move(mesh));
  scene.density = {{0.0, 1.0}, {0.5 * extinction, extinction}};
  test::look_at_cube({1.9, 2.2, 3.1}, kSide, scene);
  return scene;
}

/// The exact picture through the kernel, of many rays to a pixel.
std::vector<VolumeLight> convolved(VolumeScene scene) {
  CameraModel& camera = scene.camera;
  scene.optics.pixel_mm /= kFine;
  camera.width *= kFine;
  camera.height *= kFine;
  for (double* value : {&camera.fx, &camera.fy, &camera.cx, &camera.cy}) {
    *value *= kFine;
  }
  const std::vector<VolumeLight> fine = test::render(scene);
  std::vector<VolumeLight> picture(static_cast<std::size_t>(kSide) * kSide);
  std::vector<double> weights;
  for (int i = -2 * kFine; i <= 2 * kFine; ++i) {
    weights.push_back(quadratic_spline(static_cast<double>(i) / kFine) / kFine);
  }
  const auto weight_of = [&weights](int i) {
    const int number = i + 2 * kFine;
    return weights[static_cast<std::size_t>(number)];
  };
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const int number = y * kSide + x;
      VolumeLight& pixel = picture[static_cast<std::size_t>(number)];
      for (int j = -2 * kFine; j <= 2 * kFine; ++j) {
        for (int i = -2 * kFine; i <= 2 * kFine; ++i) {
          const int u = x * kFine + kFine / 2 + i;
          const int v = y * kFine + kFine / 2 + j;
          if (u >= 0 && v >= 0 && u < camera.width && v < camera.height) {
            const double weight = weight_of(i) * weight_of(j);
            const VolumeLight& light = test::pixel_of(fine, scene, u, v);
            pixel.light += weight * light.light;
            pixel.opacity += weight * light.opacity;
          }
        }
      }
    }
  }
  return picture;
}

TEST(CellSplat, TheKernelSumsToOne) {
  for (double t = -0.5; t <= 0.5; t += 0.01) {
    double sum = 0.0;
    for (int i = -3; i <= 3; ++i) {
      sum += quadratic_spline(t - i);
    }
    EXPECT_NEAR(sum, 1.0, 1e-15);
  }
  EXPECT_EQ(quadratic_spline(0.0), 0.75);
  EXPECT_EQ(quadratic_spline(0.5), 0.5);
  EXPECT_EQ(quadratic_spline(-1.5), 0.0);
}

/// Optical depths of all pixels are those of all cells: volume times extinction over a pixel's area.
TEST(CellSplat, OpticalDepthIsConserved) {
  VolumeScene scene = far_cube(test::cube_of_tetrahedra(24), 0.6);
  scene.optics.pixel_mm = 0.13;
  const CellProjection projection(scene, SmallCells::splatted);
  EXPECT_EQ(projection.n_splats(), scene.mesh.n_cells());
  double depth = 0.0;
  for (const VolumeLight& pixel : test::project(scene, SmallCells::splatted).pixels) {
    depth -= std::log1p(-pixel.opacity);
  }
  const double mean_extinction = 0.45;  // linear in a field whose mean is 1/2
  EXPECT_NEAR(depth, mean_extinction / (0.13 * 0.13), 1e-9 * depth);
  double sampled = 0.0;
  for (const VolumeLight& pixel : test::project(scene).pixels) {
    sampled -= std::log1p(-pixel.opacity);
  }
  EXPECT_GT(std::abs(sampled - depth), 1e-4 * depth);  // rays see it to their number
}

/// Lone cells that no ray meets are lost where they are sampled.
TEST(CellSplat, CellsBetweenPixelsAreSeen) {
  VolumeScene scene = test::scene_of(test::chosen(test::cube_of_tetrahedra(1), {0}));
  scene.density = {{0.0}, {1.0}};
  scene.colour = {{0.0}, {Array3d(1.0, 0.5, 0.25)}};
  for (Vector3d& point : scene.mesh.points) {
    point *= 0.3;
  }
  scene.camera.width = scene.camera.height = 8;
  scene.camera.cx = scene.camera.cy = 4.0;
  test::look_along({0.05, 0.05, -3.0}, {0.0, 0.0, 1.0}, Projection::parallel, scene);
  const auto total = [&](SmallCells small_cells) {
    double sum = 0.0;
    for (const VolumeLight& pixel : test::project(scene, small_cells).pixels) {
      sum -= std::log1p(-pixel.opacity);
    }
    return sum;
  };
  EXPECT_EQ(total(SmallCells::sampled), 0.0);
  EXPECT_NEAR(total(SmallCells::splatted), 0.3 * 0.3 * 0.3 / 6.0, 1e-15);
}

/// Against the exact picture through the kernel: of little depth everywhere, else away from the
/// silhouette, where 1 - exp of a mean depth is not the mean of 1 - exp.
TEST(CellSplat, IsTheExactPictureThroughTheKernel) {
  for (const double pixel_mm : {0.0, 0.13}) {
    for (const Glow glow : {Glow::chromaticity, Glow::own}) {
      for (const double extinction : {0.25 / std::sqrt(3.0), 1.0 / std::sqrt(3.0)}) {
        VolumeScene scene = far_cube(test::cube_of_tetrahedra(24), extinction);
        VolumeScene truth = far_cube(test::cube_of_tetrahedra(1), extinction);
        scene.glow = truth.glow = glow;
        scene.optics.pixel_mm = truth.optics.pixel_mm = pixel_mm;
        // A cube of 10 pixels, in perspective too.
        scene.camera.fx = scene.camera.fy = truth.camera.fx = truth.camera.fy = 28.0;
        const CellProjection projection(scene, SmallCells::splatted);
        EXPECT_EQ(projection.n_splats(), scene.mesh.n_cells());
        const std::vector<VolumeLight> exact = convolved(truth);
        const std::vector<VolumeLight> splats =
            test::project(scene, SmallCells::splatted).pixels;
        const std::vector<VolumeLight> sharp = test::render(truth);
        double everywhere = 0.0;
        double inside = 0.0;
        std::size_t n_inside = 0;
        for (int y = 0; y < kSide; ++y) {
          for (int x = 0; x < kSide; ++x) {
            const VolumeLight& a = test::pixel_of(splats, scene, x, y);
            const VolumeLight& b = test::pixel_of(exact, scene, x, y);
            const double off =
                std::max((a.light - b.light).abs().maxCoeff(), std::abs(a.opacity - b.opacity));
            everywhere = std::max(everywhere, off);
            bool is_inside = x >= 2 && y >= 2 && x < kSide - 2 && y < kSide - 2;
            for (int j = -2; is_inside && j <= 2; ++j) {
              for (int i = -2; i <= 2; ++i) {
                is_inside =
                    is_inside && test::pixel_of(sharp, scene, x + i, y + j).opacity > 0.0;
              }
            }
            if (is_inside) {
              inside = std::max(inside, off);
              ++n_inside;
            }
          }
        }
        std::printf("depth up to %.2f, %s, %s: off by %.2g, inside %.2g\n",
                    extinction * std::sqrt(3.0), std::string(to_string(glow)).c_str(),
                    pixel_mm > 0.0 ? "parallel" : "perspective", everywhere, inside);
        EXPECT_GT(n_inside, 10U);
        EXPECT_LE(inside, 0.01);
        if (extinction < 0.2) {
          EXPECT_LE(everywhere, 0.01);
        }
      }
    }
  }
}

/// The counter-example of [Williams98]: a bright cell that a dark one hides stays visible in part, as
/// both are spread, and neither knows where in the pixel the other is.
TEST(CellSplat, ABrightCellBehindADarkOneIsSeen) {
  CellMesh mesh;
  mesh.points = {{-0.3, -0.3, 2.0}, {0.3, -0.3, 2.0}, {0.0, 0.3, 2.0}, {0.0, 0.0, 3.0},
                 {-0.3, -0.3, 4.0}, {0.3, -0.3, 4.0}, {0.0, 0.3, 4.0}, {0.0, 0.0, 5.0}};
  mesh.nodes = {0, 1, 2, 3, 4, 5, 6, 7};
  mesh.begins = {0, 4};
  mesh.types = {CellType::tetrahedron, CellType::tetrahedron};
  VolumeScene scene = test::scene_of(mesh);
  scene.density_field = {.name = "cell", .is_per_cell = true, .values = {0.0, 1.0}};
  scene.colour_field = scene.density_field;
  scene.density = {{0.0, 1.0}, {1000.0, 100.0}};
  scene.colour = {{0.0, 1.0}, {Array3d::Zero(), Array3d::Ones()}};
  scene.camera.width = scene.camera.height = 5;
  scene.camera.cx = scene.camera.cy = 2.5;
  test::look_along({0.0, 0.0, 0.0}, {0.0, 0.0, 1.0}, Projection::parallel, scene);
  const auto middle = [&](SmallCells small_cells) {
    return test::pixel_of(test::project(scene, small_cells).pixels, scene, 2, 2).light[0];
  };
  EXPECT_LE(middle(SmallCells::sampled), 1e-6);
  scene.density = {{0.0, 1.0}, {10.0, 100.0}};
  const double seen = middle(SmallCells::splatted);
  // The dark one lets exp(-k(0, 0) 10 V) through, V = 0.06, and the bright one is 1 - exp(-k 100 V).
  std::printf("a bright cell behind a dark one of depth up to 10: %.2g of it is seen\n", seen);
  const double k = 0.75 * quadratic_spline(0.075);  // its centre is 0.075 beside the pixel's
  EXPECT_NEAR(seen, std::exp(-k * 0.6) * -std::expm1(-k * 6.0), 1e-12);
  EXPECT_GT(seen, 0.5);
}

}  // namespace
}  // namespace haarlight::render
