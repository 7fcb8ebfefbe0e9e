// SPDX-License-Identifier: Apache-2.0
/// @file
/// Cells of all types: the cube's closed form for a linear field, golden rays of 40 digits for a
/// quadratic one, a trilinear one against a great number of steps.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <numeric>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "render/cell_mesh/cell_mesh_io.h"
#include "render/volume/segment.h"
#include "render/volume/volume_ray_caster.h"
#include "tests/golden_file.h"
#include "tests/render/volume/volume_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using test::Transfer;
using test::VolumeLight;

constexpr double kExact = 1e-12;

TEST(VolumeCells, ALinearFieldIsExactInCellsOfEveryType) {
  for (const CellType type : test::kAllTypes) {
    double worst = 0.0;
    for (const std::size_t n : {1U, 3U}) {
      VolumeScene scene = test::scene_of(test::cube_of(type, n));
      for (const Transfer transfer :
           {Transfer::hills, Transfer::spikes, Transfer::nearly_constant}) {
        for (const Glow glow : {Glow::chromaticity, Glow::own}) {
          scene.glow = glow;
          test::set_transfer(transfer, scene);
          for (const double pixel_mm : {0.0, 2.0 / 19.0}) {
            test::look_at_cube({1.9, 2.2, 3.1}, 19, scene);
            scene.optics.pixel_mm = pixel_mm;
            worst = std::max(worst, test::error_of_cube(scene, test::render(scene)));
          }
        }
      }
    }
    std::printf("%s: largest error %.2g\n", std::string(shape_of(type).name).c_str(), worst);
    EXPECT_LE(worst, kExact) << shape_of(type).name;
  }
}

TEST(VolumeCells, AlongEdgesAndInFacesNoneIsLost) {
  for (const CellType type : test::kAllTypes) {
    VolumeScene scene = test::scene_of(test::cube_of(type, 2));
    scene.camera.width = scene.camera.height = 9;
    scene.camera.cx = scene.camera.cy = 0.5;
    scene.optics.pixel_mm = 0.125;
    scene.camera.world_from_cam.translation() = Vector3d(0.0, 0.0, -2.0);  // along z
    const std::vector<VolumeLight> picture = test::render(scene);
    int n_seen = 0;
    for (int y = 0; y < 9; ++y) {
      for (int x = 0; x < 9; ++x) {
        const VolumeLight& light = test::pixel_of(picture, scene, x, y);
        n_seen += light.opacity > 0.0 ? 1 : 0;
        if (x % 8 != 0 && y % 8 != 0) {
          const auto [origin, direction] = test::pixel_ray(scene, x, y);
          const VolumeLight truth = test::light_within_cube(scene, origin, direction);
          EXPECT_LE((light.light - truth.light).abs().maxCoeff(), kExact)
              << shape_of(type).name << ' ' << x << ' ' << y;
        }
      }
    }
    EXPECT_EQ(n_seen, 64) << shape_of(type).name;
  }
}

TEST(VolumeCells, TheEyeMayBeWithinThem) {
  for (const CellType type : test::kAllTypes) {
    VolumeScene scene = test::scene_of(test::cube_of(type, 2));
    scene.camera.width = scene.camera.height = 12;
    scene.camera.cx = scene.camera.cy = 6.0;
    scene.camera.fx = scene.camera.fy = 7.0;
    for (const Vector3d& eye :
         {Vector3d(0.41, 0.53, 0.37), Vector3d(0.5, 0.5, 0.5), Vector3d(0.25, 0.25, 0.25)}) {
      scene.camera.world_from_cam =
          look_at(eye, Vector3d(0.31, 0.57, 0.63), Vector3d(0.1, 0.2, 1.0));
      EXPECT_LE(test::error_of_cube(scene, test::render(scene)), kExact)
          << shape_of(type).name << ' ' << eye.transpose();
    }
  }
}

TEST(VolumeCells, TetrahedraAsGeneralCellsGiveTheSamePicture) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(3));
  test::look_at_cube({1.9, 2.2, 3.1}, 40, scene);
  const std::vector<VolumeLight> own = test::render(scene);
  const std::vector<VolumeLight> general = test::render(scene, {.faces = FaceForm::general});
  EXPECT_LE(test::difference(own, general), 1e-14);
}

/// Of golden rays, whose field is (q + 1.2)/2.4.
double golden_quadratic(const Vector3d& p) {
  const double q =
      0.9 -
      1.6 * ((p.x() - 0.45) * (p.x() - 0.45) + 0.8 * (p.y() - 0.55) * (p.y() - 0.55) +
             1.2 * (p.z() - 0.5) * (p.z() - 0.5)) +
      0.3 * p.x() * p.y() - 0.2 * p.y() * p.z();
  return (q + 1.2) / 2.4;
}

TEST(VolumeCells, GoldenRaysThroughQuadraticTetrahedra) {
  double worst = 0.0;
  int n_checked = 0;
  for (const test::GoldenRay& ray : test::golden_rays("quadratic")) {
    for (const std::size_t n : {1U, 3U}) {
      VolumeScene scene = test::scene_of(test::cube_of(CellType::quadratic_tetrahedron, n));
      for (std::size_t i = 0; i < scene.mesh.points.size(); ++i) {
        scene.density_field.values[i] = scene.colour_field.values[i] =
            golden_quadratic(scene.mesh.points[i]);
      }
      worst = std::max(worst, test::relative_error(ray, scene));
      ++n_checked;
    }
  }
  std::printf("%d rays, largest relative error %.2g\n", n_checked, worst);
  EXPECT_GE(n_checked, 4);
  EXPECT_LE(worst, kExact);
}

/// x y z in a hexahedron is a polynomial of degree 3 along a ray: against steps so many that within
/// each it is linear.
TEST(VolumeCells, ATrilinearFieldIsThatOfManySteps) {
  VolumeScene scene = test::scene_of(test::cube_of(CellType::hexahedron, 1));
  for (std::size_t i = 0; i < scene.mesh.points.size(); ++i) {
    scene.density_field.values[i] = scene.colour_field.values[i] = scene.mesh.points[i].prod();
  }
  test::look_at_cube({1.9, 2.2, 3.1}, 5, scene);
  const std::vector<VolumeLight> picture = test::render(scene);
  constexpr int kSteps = 100'000;
  for (const auto& [x, y] : {std::pair{2, 2}, {1, 2}, {3, 1}}) {
    const auto [origin, direction] = test::pixel_ray(scene, x, y);
    const auto [near, far] = test::within_cube(origin, direction);
    ASSERT_LT(near, far);
    VolumeLight sum;
    double transparency = 1.0;
    const double step = (far - near) / kSteps;
    for (int i = 0; i < kSteps; ++i) {
      const double f_near = (origin + (near + i * step) * direction).prod();
      const double f_far = (origin + (near + (i + 1) * step) * direction).prod();
      const SegmentWeights weights = segment_weights(
          scene.density.at(f_near), scene.density.at(f_far), step * direction.norm());
      sum.light += transparency * (weights.of_chromaticity.near * scene.colour.at(f_near) +
                                   weights.of_chromaticity.far * scene.colour.at(f_far));
      transparency *= weights.transparency;
    }
    const VolumeLight& light = test::pixel_of(picture, scene, x, y);
    // Steps are off by the square of their length, over 12, times curvatures of up to 100.
    EXPECT_LE((light.light - sum.light).abs().maxCoeff(), 1e-8);
    EXPECT_NEAR(light.opacity, 1.0 - transparency, 1e-8);
  }
}

/// Meshes of the cube that gmsh wrote, of all types, with faces that meet only in part.
TEST(VolumeCells, SharedMeshesOfTheCube) {
  const std::filesystem::path folder = HAARLIGHT_SOURCE_DIR "/../shared/data/volume";
  if (!std::filesystem::exists(folder)) {
    GTEST_SKIP() << "no " << folder;
  }
  for (const char* name :
       {"zoo_mixed_8.vtu", "box_tet_lin_small.vtu", "box_tet_quad_10k.vtu"}) {
    VolumeScene scene = test::scene_of(read_cell_mesh(folder / name));
    test::look_at_cube({1.9, 2.2, 3.1}, 48, scene);
    const double error = test::error_of_cube(scene, test::render(scene));
    std::printf("%s: largest error %.2g\n", name, error);
    EXPECT_LE(error, kExact) << name;
  }
}

/// Whatever the numbers of their points.
TEST(VolumeCells, NeighboursPartTheirFaceAlike) {
  constexpr std::size_t kBoxes = 3;
  for (const CellType type : {CellType::hexahedron, CellType::wedge, CellType::pyramid}) {
    CellMesh mesh = test::cube_of(type, kBoxes);
    std::vector<std::uint32_t> moved(mesh.points.size());
    std::iota(moved.begin(), moved.end(), 0U);
    std::ranges::shuffle(moved, std::mt19937(7));
    const std::vector<Vector3d> points = mesh.points;
    for (std::size_t i = 0; i < points.size(); ++i) {
      mesh.points[moved[i]] = points[i];
    }
    for (std::uint32_t& node : mesh.nodes) {
      node = moved[node];
    }
    const CellFaces faces = connect_cells(mesh, "cube.vtu", FaceForm::general);
    EXPECT_EQ(faces.boundary.size(), std::size_t{12} * kBoxes * kBoxes) << shape_of(type).name;
  }
}

}  // namespace
}  // namespace haarlight::render
