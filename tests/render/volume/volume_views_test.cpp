// SPDX-License-Identifier: Apache-2.0
/// @file
/// Views whose rays run within faces of cells, along their edges and through their vertices, from
/// everywhere: eyes and targets on a grid that the mesh lies on, too.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <numeric>
#include <random>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "tests/render/volume/volume_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Array3d;
using Eigen::Vector3d;
using test::Split;
using test::VolumeLight;

/// Rounding of 1e-15 of an eye on one of the cube's sides is 3e-13 along a ray that leaves it at a third
/// of a degree, and extinctions are up to 20.
constexpr double kExact = 4e-12;

double difference(const VolumeLight& a, const VolumeLight& b) {
  return std::max((a.light - b.light).abs().maxCoeff(), std::abs(a.opacity - b.opacity));
}

/// Whether a ray within a side of the cube sees something that one beside it does not.
bool is_on_border(const VolumeScene& scene, const Vector3d& origin, const Vector3d& direction,
                  const VolumeLight& light) {
  for (unsigned i = 0; i < 8; ++i) {
    const auto by = [i](unsigned bit) { return (i & bit) != 0U ? 1e-7 : -1e-7; };
    const Vector3d beside = origin + Vector3d(by(1), by(2), by(4));
    if (difference(light, test::light_within_cube(scene, beside, direction)) > 1e-4) {
      return true;
    }
  }
  return false;
}

/// The largest difference to the closed form among rays that are not on the cube's border.
double worst_of(const VolumeScene& scene) {
  const std::vector<VolumeLight> picture = test::render(scene);
  double worst = 0.0;
  std::size_t i = 0;
  for (int y = 0; y < scene.camera.height; ++y) {
    for (int x = 0; x < scene.camera.width; ++x, ++i) {
      const auto [origin, direction] = test::pixel_ray(scene, x, y);
      const VolumeLight truth = test::light_within_cube(scene, origin, direction);
      const double error = difference(picture[i], truth);
      if (!(error <= worst) && !is_on_border(scene, origin, direction, truth)) {
        worst = error;
      }
    }
  }
  return worst;
}

/// The largest difference of two pictures where rays are not on a border of the mesh: where rays beside
/// them see the same.
double difference_within(const std::vector<VolumeLight>& a, const std::vector<VolumeLight>& b,
                         const VolumeScene& scene) {
  std::vector<std::vector<VolumeLight>> beside;
  double worst = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const double off = difference(a[i], b[i]);
    if (off <= worst) {
      continue;
    }
    for (unsigned k = 0; off > kExact && k < 8 && beside.size() < 8; ++k) {
      const auto by = [k](unsigned bit) { return (k & bit) != 0U ? 1e-7 : -1e-7; };
      VolumeScene moved = scene;
      moved.camera.world_from_cam.translation() += Vector3d(by(1), by(2), by(4));
      beside.push_back(test::render(moved));
    }
    if (std::ranges::none_of(beside, [&](const std::vector<VolumeLight>& other) {
          return difference(a[i], other[i]) > 1e-4;
        })) {
      worst = off;
    }
  }
  return worst;
}

constexpr int kSide = 17;

void look(const Vector3d& eye, const Vector3d& direction, const Vector3d& up, double focal,
          VolumeScene& scene) {
  scene.camera.width = scene.camera.height = kSide;
  scene.camera.cx = scene.camera.cy = 0.5 * kSide;
  scene.camera.fx = scene.camera.fy = focal;
  scene.camera.world_from_cam = look_at(eye, eye + direction, up);
}

/// A view of a cube of n^3 about grid points, one of many.
/// @return  whether there is one
bool draw_view(std::mt19937& random, unsigned n, VolumeScene& scene) {
  const auto grid = [&] { return static_cast<double>(random() % (4 * n + 1)) / (4.0 * n); };
  Vector3d eye(grid(), grid(), grid());
  if (random() % 2 == 0) {  // outside
    eye = 4.0 * eye - Vector3d::Constant(2.0);
  }
  Vector3d direction = Vector3d(grid(), grid(), grid()) - eye;
  if (random() % 3 == 0) {
    const double sign = random() % 2 == 0 ? 1.0 : -1.0;
    direction = sign * Vector3d::Unit(static_cast<Eigen::Index>(random() % 3));
  }
  const Vector3d up = random() % 2 == 0 ? Vector3d(0.0, 0.0, 1.0) : Vector3d(0.0, 1.0, 0.0);
  if (!(up.cross(direction).norm() > 0.05 * direction.norm())) {
    return false;
  }
  look(eye, direction, up, kSide * (0.25 + 0.25 * static_cast<double>(random() % 8)), scene);
  scene.optics.pixel_mm = random() % 3 == 0 ? 0.125 / n : 0.0;
  scene.glow = random() % 2 == 0 ? Glow::own : Glow::chromaticity;
  test::set_transfer(static_cast<test::Transfer>(random() % 3), scene);
  return true;
}

TEST(VolumeViews, RaysWithinFacesOfOneCube) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(3));
  test::set_transfer(test::Transfer::spikes, scene);
  // Pixels of the diagonal see along the planes x - z = const of faces.
  const Vector3d eye(2.0 / 3.0, 0.25, 1.0 / 3.0);
  double worst = 0.0;
  for (const double focal : {5.0, 6.714, 7.0, 11.0, 13.3}) {
    look(eye, -Vector3d::UnitY(), Vector3d::UnitZ(), focal, scene);
    worst = std::max(worst, worst_of(scene));
    look(eye, Vector3d::UnitY(), Vector3d::UnitZ(), focal, scene);
    worst = std::max(worst, worst_of(scene));
  }
  std::printf("largest error %.2g\n", worst);
  EXPECT_LE(worst, kExact);
}

TEST(VolumeViews, RaysWithinFacesFromEverywhere) {
  std::mt19937 random(1);
  double worst = 0.0;
  int n_views = 0;
  int n_off = 0;
  for (int i = 0; i < 2000; ++i) {
    const auto n = static_cast<unsigned>(1 + random() % 5);
    const Split split = random() % 2 == 0 ? Split::six : Split::five;
    VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(n, split));
    if (draw_view(random, n, scene)) {
      const double error = worst_of(scene);
      worst = std::max(worst, error);
      n_off += error <= kExact ? 0 : 1;
      ++n_views;
    }
  }
  std::printf("%d of %d views are off, by up to %.2g\n", n_off, n_views, worst);
  EXPECT_LE(worst, kExact);
}

/// Cells side by side without common points do not overlap, however a ray meets them.
TEST(VolumeViews, CellsWithPointsOfTheirOwnDoNotOverlap) {
  std::mt19937 random(2);
  double worst = 0.0;
  int n_views = 0;
  int n_refused = 0;
  for (int i = 0; i < 500; ++i) {
    const auto n = static_cast<unsigned>(1 + random() % 3);
    VolumeScene scene = test::scene_of(test::torn(test::cube_of_tetrahedra(n)));
    if (draw_view(random, n, scene)) {
      ++n_views;
      try {
        worst = std::max(worst, worst_of(scene));
      } catch (const Error&) {
        ++n_refused;
      }
    }
  }
  std::printf("%d of %d views are refused, the others off by up to %.2g\n", n_refused, n_views,
              worst);
  EXPECT_EQ(n_refused, 0);
  EXPECT_LE(worst, kExact);
}

/// Cells of all types and of holes, connected or each of its own points, in an order of which rays that
/// run within faces do not know; the same cells as rays that walk from one to the next.
TEST(VolumeViews, ProjectedCellsGiveThePicturesOfRays) {
  constexpr unsigned kFirstTypes = 5;  // straight cells of the others pass by the same faces
  std::mt19937 random(3);
  double worst = 0.0;
  int n_views = 0;
  std::uint64_t n_violations = 0;
  std::uint64_t n_exact = 0;
  for (int i = 0; i < 500; ++i) {
    const auto n = static_cast<unsigned>(1 + random() % 4);
    CellMesh mesh = random() % 3 == 0
                        ? test::cube_of_tetrahedra(n, Split::five)
                        : test::cube_of(static_cast<CellType>(random() % kFirstTypes), n);
    std::vector<std::size_t> cells(mesh.n_cells());
    std::iota(cells.begin(), cells.end(), 0U);
    std::ranges::shuffle(cells, random);
    if (random() % 2 == 0) {
      cells.resize(1 + random() % cells.size());
    }
    mesh = test::chosen(mesh, cells);
    VolumeScene scene = test::scene_of(random() % 4 == 0 ? test::torn(mesh) : mesh);
    if (draw_view(random, n, scene)) {
      const test::ProjectedPicture picture = test::project(scene);
      worst = std::max(worst, difference_within(test::render(scene), picture.pixels, scene));
      n_violations += picture.counts.violations;
      n_exact += picture.counts.exact_sides;
      ++n_views;
    }
  }
  std::printf("%d views, %llu sides by exact arithmetic; they differ by up to %.2g\n", n_views,
              static_cast<unsigned long long>(n_exact), worst);
  EXPECT_EQ(n_violations, 0U);
  EXPECT_GT(n_exact, 10'000U);
  EXPECT_LE(worst, kExact);
}

}  // namespace
}  // namespace haarlight::render
