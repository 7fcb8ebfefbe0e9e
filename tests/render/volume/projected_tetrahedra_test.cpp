// SPDX-License-Identifier: Apache-2.0
/// @file
/// Previews by projected tetrahedra: where they are exact, at which rate they come to the exact picture,
/// and what they do in views and media that are extreme.

#include "render/volume/projected_tetrahedra.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "render/volume/cell_tetrahedra.h"
#include "render/volume/tetrahedron_clipping.h"
#include "tests/render/volume/volume_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Array3d;
using Eigen::Vector3d;
using test::VolumeLight;

constexpr auto kMethods = std::to_array<Preview>({Preview::m0, Preview::m1, Preview::m3});
constexpr auto kOrders =
    std::to_array<PreviewOrder>({PreviewOrder::centroid, PreviewOrder::exact});
/// Some hundred cells of a ray, composited in float.
constexpr double kFloat = 1e-5;

VolumeScene homogeneous(CellMesh mesh, double extinction, const Array3d& colour) {
  VolumeScene scene = test::scene_of(std::move(mesh));
  scene.density = {{0.0}, {extinction}};
  scene.colour = {{0.0}, {colour}};
  return scene;
}

double rms_difference(const std::vector<VolumeLight>& a, const std::vector<VolumeLight>& b) {
  double sum = 0.0;
  double n = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    if (a[i].opacity > 0.0 || b[i].opacity > 0.0) {
      sum += (a[i].light - b[i].light).square().sum();
      n += 3.0;
    }
  }
  return std::sqrt(sum / n);
}

bool is_finite(const std::vector<VolumeLight>& picture) {
  return std::ranges::all_of(picture, [](const VolumeLight& pixel) {
    return pixel.light.isFinite().all() && pixel.opacity >= 0.0 && pixel.opacity <= 1.0 &&
           (pixel.light >= 0.0).all();
  });
}

double volume_of(const std::array<Vector3d, 4>& corners) {
  const auto& [a, b, c, d] = corners;
  return (b - a).cross(c - a).dot(d - a) / 6.0;
}

TEST(CellTetrahedra, FillTheirCells) {
  const std::array<std::pair<CellType, std::size_t>, 5> kinds = {
      {{CellType::tetrahedron, 1},
       {CellType::hexahedron, 6},
       {CellType::wedge, 3},
       {CellType::pyramid, 2},
       {CellType::quadratic_tetrahedron, 8}}};
  for (const auto& [type, n_of_cell] : kinds) {
    const CellMesh mesh = test::cube_of(type, 2);
    const std::vector<CellTetrahedron> tetrahedra = cut_into_tetrahedra(mesh);
    ASSERT_EQ(tetrahedra.size(), n_of_cell * mesh.n_cells()) << shape_of(type).name;
    std::vector<double> volumes(mesh.n_cells());
    for (const CellTetrahedron& tetrahedron : tetrahedra) {
      std::array<Vector3d, 4> corners;
      for (std::size_t i = 0; i < 4; ++i) {
        corners.at(i) = mesh.points[tetrahedron.nodes.at(i)];
      }
      const double volume = std::abs(volume_of(corners));
      EXPECT_GT(volume, 1e-4);
      volumes[tetrahedron.cell] += volume;
    }
    for (std::size_t i = 0; i < mesh.n_cells(); ++i) {
      EXPECT_NEAR(volumes[i], cell_volume(mesh, i), 1e-14);
    }
  }
}

TEST(TetrahedronClipping, PartsFillTheWhole) {
  ClipTetrahedron whole;
  const std::array<Vector3d, 4> corners = {
      {{0.1, 0.2, 0.3}, {1.4, 0.1, 0.9}, {0.3, 1.2, 1.7}, {0.2, 0.4, 2.6}}};
  const auto field = [](const Vector3d& p) { return 1.0 + p.x() - 2.0 * p.y() + 0.5 * p.z(); };
  for (std::size_t i = 0; i < 4; ++i) {
    whole.at(i).camera = corners.at(i);
    whole.at(i).extinction = field(corners.at(i));
  }
  double sum = 0.0;
  for (const auto& [low, high] :
       {std::pair{-1.0, 0.5}, std::pair{0.5, 1.2}, std::pair{1.2, 2.0}, std::pair{2.0, 2.2},
        std::pair{2.2, 9.0}}) {
    for (const ClipTetrahedron& part : clip(whole, low, high)) {
      std::array<Vector3d, 4> places;
      for (std::size_t i = 0; i < 4; ++i) {
        places.at(i) = part.at(i).camera;
        EXPECT_GE(places.at(i).z(), low);
        EXPECT_LE(places.at(i).z(), high);
        EXPECT_NEAR(part.at(i).extinction, field(places.at(i)), 1e-14);
      }
      sum += std::abs(volume_of(places));
    }
  }
  EXPECT_NEAR(sum, std::abs(volume_of(corners)), 1e-14);
  EXPECT_TRUE(clip(whole, 2.7, 3.0).empty());
}

/// Parallel rays in a homogeneous cell: thickness is linear over each triangle.
TEST(ProjectedTetrahedra, OneHomogeneousCellIsExact) {
  const CellMesh cell = test::chosen(test::cube_of_tetrahedra(1), {2});
  VolumeScene scene = homogeneous(cell, 2.5, {0.9, 0.4, 0.1});
  scene.background.colour = {0.1, 0.2, 0.3};
  for (const Glow glow : {Glow::chromaticity, Glow::own}) {
    scene.glow = glow;
    double worst_m0 = 0.0;
    for (const Vector3d& eye : {Vector3d(1.9, 2.2, 3.1), Vector3d(0.5, 0.6, -3.0),
                                Vector3d(-2.0, 3.0, 0.4), Vector3d(4.0, 0.5, 0.5)}) {
      test::look_at_cube(eye, 64, scene);
      scene.optics.pixel_mm = 2.0 / 61.0;
      const std::vector<VolumeLight> exact = test::render(scene);
      for (const Preview method : {Preview::m1, Preview::m3}) {
        EXPECT_LE(test::difference(test::preview(scene, {.method = method}), exact), 2e-6);
      }
      worst_m0 = std::max(
          worst_m0, test::difference(test::preview(scene, {.method = Preview::m0}), exact));
    }
    // A chord of 1 - exp(-t), t up to 2.5 sqrt(3), is off by up to 0.5, and here by what is seen of it.
    EXPECT_GT(worst_m0, 0.05);
    EXPECT_LT(worst_m0, 0.5);
  }
}

/// Along axes, in faces and along edges, pixels' centres on the lines of the mesh: each pixel has each
/// cell once.
TEST(ProjectedTetrahedra, NothingIsLostOrTwiceAlongEdgesAndFaces) {
  for (const test::Split split : {test::Split::six, test::Split::five}) {
    VolumeScene scene = homogeneous(test::cube_of_tetrahedra(4, split), 1.7, {1.0, 0.5, 0.25});
    for (const Vector3d& eye :
         {Vector3d(0.5, 0.5, 3.0), Vector3d(0.5, -2.5, 0.5), Vector3d(-4.5, 0.5, 0.5)}) {
      scene.camera.width = scene.camera.height = 49;
      scene.camera.cx = scene.camera.cy = 24.5;
      scene.camera.world_from_cam.translation() = eye;
      const Vector3d axis = (Vector3d::Constant(0.5) - eye).normalized();
      const Vector3d across = axis.unitOrthogonal().cwiseAbs().maxCoeff() > 0.99
                                  ? axis.unitOrthogonal()
                                  : Vector3d(0.0, 1.0, 0.0).cross(axis).normalized();
      scene.camera.world_from_cam.linear().col(0) = across;
      scene.camera.world_from_cam.linear().col(1) = axis.cross(across);
      scene.camera.world_from_cam.linear().col(2) = axis;
      scene.optics.pixel_mm = 1.0 / 32.0;
      for (const Preview method : {Preview::m1, Preview::m3}) {
        const std::vector<VolumeLight> picture = test::preview(scene, {.method = method});
        std::size_t n = 0;
        for (int y = 9; y < 40; ++y) {
          for (int x = 9; x < 40; ++x, ++n) {
            ASSERT_NEAR(test::pixel_of(picture, scene, x, y).opacity, -std::expm1(-1.7), kFloat)
                << x << ' ' << y;
          }
        }
        EXPECT_EQ(n, 961U);
        EXPECT_EQ(test::pixel_of(picture, scene, 6, 24).opacity, 0.0);
      }
    }
  }
}

/// M0 is of first order in the cells' size, M1 and M3 of second; so is the order by centroids.
TEST(ProjectedTetrahedra, ComesToTheExactPictureAsCellsShrink) {
  for (const double pixel_mm : {0.0, 2.0 / 48.0}) {
    for (const Glow glow : {Glow::chromaticity, Glow::own}) {
      for (const Preview method : kMethods) {
        for (const PreviewOrder order : kOrders) {
          std::vector<double> errors;
          for (const std::size_t n : {6U, 12U, 24U}) {
            VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(n));
            scene.glow = glow;
            scene.density = {{0.0, 1.0}, {0.5, 4.0}};
            scene.colour = {{0.0, 1.0}, {Array3d(0.9, 0.1, 0.3), Array3d(0.1, 1.0, 0.4)}};
            test::look_at_cube({1.9, 2.2, 3.1}, 48, scene);
            scene.optics.pixel_mm = pixel_mm;
            errors.push_back(rms_difference(
                test::preview(scene, {.method = method, .order = order}), test::render(scene)));
          }
          const double rate = std::log2(errors[1] / errors[2]);
          std::printf(
              "%s, %s, %s, %s: rms %.2g %.2g %.2g, order %.2f\n",
              std::string(to_string(method)).c_str(), std::string(to_string(order)).c_str(),
              std::string(to_string(glow)).c_str(), pixel_mm > 0.0 ? "parallel" : "perspective",
              errors[0], errors[1], errors[2], rate);
          EXPECT_GT(rate, method == Preview::m0 ? 0.8 : 1.7);
          EXPECT_LT(errors[2], method == Preview::m0 ? 0.01 : 5e-4);
        }
      }
    }
  }
}

/// Rows of the tables within cells: missed but at M3's thick points, and less so in smaller cells.
TEST(ProjectedTetrahedra, CellsOfEveryTypeComeToTheExactPicture) {
  for (const CellType type : {CellType::tetrahedron, CellType::hexahedron, CellType::wedge,
                              CellType::pyramid, CellType::quadratic_tetrahedron}) {
    for (const Preview method : kMethods) {
      std::vector<double> errors;
      for (const std::size_t n : {4U, 16U}) {
        VolumeScene scene = test::scene_of(test::cube_of(type, n));
        test::look_at_cube({1.9, 2.2, 3.1}, 40, scene);
        VolumeScene truth = test::scene_of(test::cube_of_tetrahedra(1));
        truth.camera = scene.camera;
        errors.push_back(
            rms_difference(test::preview(scene, {.method = method}), test::render(truth)));
      }
      EXPECT_LT(errors[1], errors[0] / (method == Preview::m0 ? 2.5 : 6.0))
          << shape_of(type).name << ' ' << to_string(method) << ' ' << errors[0];
    }
  }
}

TEST(ProjectedTetrahedra, FieldsPerCellAndBackground) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(8));
  scene.colour_field = {.name = "number", .is_per_cell = true, .values = {}};
  for (std::size_t i = 0; i < scene.mesh.n_cells(); ++i) {
    scene.colour_field.values.push_back(static_cast<double>(i % 7) / 7.0);
  }
  scene.density = {{0.0}, {2.0}};
  scene.background.colour = {0.2, 0.4, 0.1};
  test::look_at_cube({1.9, 2.2, 3.1}, 40, scene);
  scene.optics.pixel_mm = 2.0 / 37.0;
  EXPECT_LE(test::difference(test::preview(scene, {.order = PreviewOrder::exact}),
                             test::render(scene)),
            kFloat);
}

TEST(ProjectedTetrahedra, EmptyAndOpaqueMedia) {
  VolumeScene empty = homogeneous(test::cube_of_tetrahedra(3), 0.0, {1.0, 1.0, 1.0});
  empty.background.colour = {0.2, 0.4, 0.1};
  test::look_at_cube({1.9, 2.2, 3.1}, 40, empty);
  for (const Preview method : kMethods) {
    for (const VolumeLight& pixel : test::preview(empty, {.method = method})) {
      EXPECT_EQ(pixel.opacity, 0.0);
      EXPECT_EQ((pixel.light - empty.background.colour).abs().maxCoeff(), 0.0);
    }
  }
  VolumeScene opaque = homogeneous(test::cube_of_tetrahedra(3), 1e5, {0.7, 0.5, 0.1});
  opaque.background.colour = {0.2, 0.4, 0.1};
  test::look_at_cube({1.9, 2.2, 3.1}, 40, opaque);
  for (const Preview method : {Preview::m1, Preview::m3}) {
    const VolumeLight middle =
        test::pixel_of(test::preview(opaque, {.method = method}), opaque, 20, 20);
    EXPECT_NEAR(middle.opacity, 1.0, 1e-6);
    EXPECT_NEAR((middle.light - Array3d(0.7, 0.5, 0.1)).abs().maxCoeff(), 0.0, 1e-6);
  }
}

/// A large cell whose centroid is farther than that of a small one that it hides.
TEST(ProjectedTetrahedra, CentroidsMayBeWrongWhereTheExactOrderIsNot) {
  CellMesh mesh;
  mesh.points = {{-1.0, -1.0, 0.0},  {1.0, -1.0, 0.0},  {0.0, 1.0, 0.0},  {0.0, 0.0, 10.0},
                 {-0.1, -0.97, 1.5}, {0.1, -0.97, 1.5}, {0.0, -0.9, 1.5}, {0.0, -0.93, 1.7}};
  mesh.nodes = {0, 1, 2, 3, 4, 5, 6, 7};
  mesh.begins = {0, 4};
  mesh.types = {CellType::tetrahedron, CellType::tetrahedron};
  VolumeScene scene = test::scene_of(mesh);
  scene.density_field = {.name = "cell", .is_per_cell = true, .values = {0.0, 1.0}};
  scene.colour_field = scene.density_field;
  scene.density = {{0.0, 1.0}, {40.0, 40.0}};
  scene.colour = {{0.0, 1.0}, {Array3d(1.0, 0.0, 0.0), Array3d(0.0, 1.0, 0.0)}};
  scene.camera.width = scene.camera.height = 64;
  scene.camera.cx = scene.camera.cy = 32.0;
  test::look_along({0.0, -0.9, -5.0}, {0.0, 0.0, 1.0}, Projection::parallel, scene);
  scene.optics.pixel_mm = 0.01;
  const std::vector<VolumeLight> exact = test::render(scene);
  const auto off = [&](PreviewOrder order) {
    return test::difference(test::preview(scene, {.method = Preview::m1, .order = order}),
                            exact);
  };
  EXPECT_LE(off(PreviewOrder::exact), kFloat);
  EXPECT_GT(off(PreviewOrder::centroid), 0.5);
}

TEST(ProjectedTetrahedra, TheEyeMayBeInTheMesh) {
  double worst = 0.0;
  for (const std::size_t n : {1U, 5U}) {
    VolumeScene scene = homogeneous(test::cube_of_tetrahedra(n), 1.5, {0.9, 0.6, 0.3});
    for (const Vector3d& eye : {Vector3d(0.4, 0.45, 0.7), Vector3d(0.2, 0.2, 0.2),
                                Vector3d(0.5, 0.5, 1.0), Vector3d(0.0, 0.0, 1.2)}) {
      test::look_at_cube(eye, 40, scene);
      const PreviewMesh mesh(scene);
      const ProjectedTetrahedra preview(mesh, {});
      EXPECT_GT(preview.counts().clipped, 0U);
      EXPECT_GT(preview.nearest(), 0.0);
      EXPECT_LT(preview.nearest(), 2e-4);
      const std::vector<VolumeLight> picture = test::preview(scene);
      EXPECT_TRUE(is_finite(picture));
      worst = std::max(worst, test::difference(picture, test::render(scene)));
    }
  }
  std::printf("eye in the mesh: largest error %.2g\n", worst);
  EXPECT_LE(worst, 0.01);
}

TEST(ProjectedTetrahedra, ClippingPlanes) {
  VolumeScene scene = homogeneous(test::cube_of_tetrahedra(4), 1.5, {0.9, 0.6, 0.3});
  test::look_at_cube({1.9, 2.2, 3.1}, 40, scene);
  const std::vector<VolumeLight> whole = test::preview(scene);
  scene.optics.near_mm = 3.1;
  scene.optics.far_mm = 3.6;
  for (const double pixel_mm : {0.0, 2.0 / 37.0}) {
    scene.optics.pixel_mm = pixel_mm;
    const std::vector<VolumeLight> picture = test::preview(scene);
    EXPECT_LE(test::difference(picture, test::render(scene)), pixel_mm > 0.0 ? kFloat : 0.01);
    EXPECT_GT(test::difference(picture, whole), 0.1);
  }
}

TEST(ProjectedTetrahedra, TheSameBitsOnAnyNumberOfThreads) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(8));
  test::look_at_cube({1.9, 2.2, 3.1}, 100, scene);
  for (const PreviewOrder order : kOrders) {
    std::vector<std::vector<VolumeLight>> pictures;
    for (const int n : {1, 2, 7}) {
      const ThreadLimit limit(n);
      pictures.push_back(test::preview(scene, {.method = Preview::m3, .order = order}));
    }
    EXPECT_EQ(test::difference(pictures[0], pictures[1]), 0.0);
    EXPECT_EQ(test::difference(pictures[0], pictures[2]), 0.0);
  }
}

TEST(ProjectedTetrahedra, ExtremesAreFinite) {
  for (const double extinction : {1e-300, 1e-12, 1e12, 1e99}) {
    for (const double colour : {0.0, 1e-300, 1e99}) {
      for (const double size : {1e-9, 1.0, 1e9}) {
        VolumeScene scene =
            homogeneous(test::cube_of_tetrahedra(2), extinction, Array3d::Constant(colour));
        scene.mesh.points.emplace_back(0.5, 0.5, 0.5);  // of no cell
        test::look_at_cube({1.9, 2.2, 3.1}, 20, scene);
        for (Vector3d& point : scene.mesh.points) {
          point *= size;
        }
        scene.camera.world_from_cam.translation() *= size;
        for (const Glow glow : {Glow::chromaticity, Glow::own}) {
          scene.glow = glow;
          for (const Preview method : kMethods) {
            EXPECT_TRUE(is_finite(test::preview(scene, {.method = method})))
                << extinction << ' ' << colour << ' ' << size << ' ' << to_string(method);
          }
        }
      }
    }
  }
}

TEST(ProjectedTetrahedra, RefusesContours) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(1));
  scene.contour_field = scene.density_field;
  scene.contours = {{.value = 0.5, .opacity = 0.5}};
  EXPECT_THROW(PreviewMesh{scene}, ContractViolation);
}

}  // namespace
}  // namespace haarlight::render
