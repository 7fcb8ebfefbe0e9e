// SPDX-License-Identifier: Apache-2.0
/// @file
/// Cells of all types with nodes beside their corners, bent: a linear field is linear whatever bends within
/// the cube; the order of cells, turning all together, eyes within cells; faces one by one by their nodes'
/// shape functions.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <random>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "render/cell_mesh/cell_mesh_check.h"
#include "render/cell_mesh/shape_functions.h"
#include "render/volume/bent_face.h"
#include "render/volume/volume_ray_caster.h"
#include "render/volume/volume_view.h"
#include "tests/render/volume/volume_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using test::VolumeLight;

constexpr double kExact = 1e-12;

/// Of a cube's edge: a pyramid is half as high; and a third of an edge is moved ninefold by its slope.
double size_of(CellType type) {
  return type == CellType::quadratic_pyramid   ? 0.5
         : type == CellType::cubic_tetrahedron ? 0.25
                                               : 1.0;
}

/// The cube in n^3 cubes of cells. All nodes are moved by up to a part of that size, corners by half as much,
/// those on the cube's surface within it.
CellMesh bent_cube(CellType type, std::size_t n, double part, unsigned seed = 1) {
  CellMesh mesh = test::cube_of(type, n);
  std::vector<bool> is_corner(mesh.points.size());
  for (std::size_t i = 0; i < mesh.n_cells(); ++i) {
    for (const std::uint32_t node : mesh.nodes_of(i).first(shape_of(type).n_corners)) {
      is_corner[node] = true;
    }
  }
  std::mt19937 random(seed);
  const double most = part * size_of(type) / static_cast<double>(n);
  std::uniform_real_distribution<double> move(-most, most);
  for (std::size_t i = 0; i < mesh.points.size(); ++i) {
    for (double& x : mesh.points[i]) {
      const double by = (is_corner[i] ? 0.5 : 1.0) * move(random);
      x = x > 0.0 && x < 1.0 ? x + by : x;
    }
  }
  for (std::size_t i = 0; i < mesh.n_cells(); ++i) {
    EXPECT_EQ(folding_of(mesh, i), Folding::none) << shape_of(type).name << ' ' << part;
  }
  return mesh;
}

struct Rendered {
  std::vector<VolumeLight> pixels;
  VolumeCounts counts;
};
Rendered rendered(const VolumeScene& scene) {
  const VolumeRayCaster caster(scene, {});
  Rendered made{.pixels = test::picture_by(caster, scene), .counts = caster.counts()};
  caster.require_no_overlap();
  return made;
}

std::string name_of(CellType type) { return std::string(shape_of(type).name); }

TEST(CurvedCells, ALinearFieldIsExactWhateverBends) {
  for (const CellType type : test::kBentTypes) {
    double worst = 0.0;
    for (const double part : {1e-9, 1e-4, 0.05, 0.1}) {
      for (const std::size_t n : {1U, 2U}) {
        VolumeScene scene = test::scene_of(bent_cube(type, n, part));
        for (const double pixel_mm : {0.0, 2.0 / 13.0}) {
          test::look_at_cube({1.9, 2.2, 3.1}, 13, scene);
          scene.optics.pixel_mm = pixel_mm;
          const Rendered made = rendered(scene);
          const double error = test::error_of_cube(scene, made.pixels);
          EXPECT_LE(error, kExact) << name_of(type) << ' ' << part << ' ' << n;
          EXPECT_EQ(made.counts.undecided_rays, 0U) << name_of(type) << ' ' << part;
          EXPECT_EQ(made.counts.lost_points, 0U) << name_of(type) << ' ' << part;
          worst = std::max(worst, error);
        }
      }
    }
    std::printf("%s: largest error %.2g\n", name_of(type).c_str(), worst);
  }
}

TEST(CurvedCells, TheOrderOfCellsChangesNothing) {
  for (const CellType type : test::kBentTypes) {
    VolumeScene scene = test::scene_of(bent_cube(type, 2, 0.1));
    test::look_at_cube({1.9, 2.2, 3.1}, 13, scene);
    const std::vector<VolumeLight> picture = rendered(scene).pixels;
    std::vector<std::size_t> order(scene.mesh.n_cells());
    for (std::size_t i = 0; i < order.size(); ++i) {
      order[i] = order.size() - 1 - i;
    }
    scene.mesh = test::chosen(scene.mesh, order);
    EXPECT_EQ(test::difference(picture, rendered(scene).pixels), 0.0) << name_of(type);
  }
}

/// With random values at the nodes: nothing but the positions' roundings changes.
TEST(CurvedCells, MeshAndCameraTurnedTogether) {
  const Eigen::Isometry3d turn = Eigen::Translation3d(0.3, -0.7, 1.1) *
                                 Eigen::AngleAxisd(1.1, Vector3d(0.3, -0.5, 0.8).normalized());
  for (const CellType type : test::kBentTypes) {
    VolumeScene scene = test::scene_of(bent_cube(type, 1, 0.1));
    std::mt19937 random(7);
    std::uniform_real_distribution<double> number(0.0, 1.0);
    for (double& value : scene.density_field.values) {
      value = number(random);
    }
    scene.colour_field = scene.density_field;
    test::look_at_cube({1.9, 2.2, 3.1}, 13, scene);
    const std::vector<VolumeLight> picture = rendered(scene).pixels;
    for (Vector3d& point : scene.mesh.points) {
      point = turn * point;
    }
    scene.camera.world_from_cam = turn * scene.camera.world_from_cam;
    const double difference = test::difference(picture, rendered(scene).pixels);
    std::printf("%s: turned, differs by %.2g\n", name_of(type).c_str(), difference);
    EXPECT_LE(difference, 1e-11) << name_of(type);
  }
}

/// In a cell, and on a bent face: a point of it by its nodes' shape functions.
TEST(CurvedCells, TheEyeMayBeWithinThem) {
  for (const CellType type : test::kBentTypes) {
    VolumeScene scene = test::scene_of(bent_cube(type, 2, 0.05));
    scene.camera.width = scene.camera.height = 10;
    scene.camera.cx = scene.camera.cy = 5.0;
    scene.camera.fx = scene.camera.fy = 6.0;
    const CellFaces faces = connect_cells(scene.mesh, "cube.vtu");
    const auto inner = std::ranges::find_if(faces.faces, [](const CellFace& face) {
      return face.is_bent() && face.neighbour != kNoCell;
    });
    ASSERT_NE(inner, faces.faces.end());
    const auto number = static_cast<std::uint32_t>(inner - faces.faces.begin());
    const auto cell = static_cast<std::uint32_t>(
        std::ranges::upper_bound(faces.begins, number) - faces.begins.begin() - 1);
    ShapeFunctions shape;
    find_shape(type,
               coordinates_on_face(type, inner->bent_side,
                                   shape_of(type).faces[inner->bent_side][3] == kNone
                                       ? std::array{0.3, 0.3, 0.4, 0.0}
                                       : std::array{0.2, 0.3, 0.3, 0.2}),
               shape);
    Vector3d on_face = Vector3d::Zero();
    for (std::size_t i = 0; i < shape_of(type).n_nodes; ++i) {
      on_face += shape.weights.at(i) * scene.mesh.points[scene.mesh.nodes_of(cell)[i]];
    }
    for (const Vector3d& eye : {Vector3d(0.41, 0.53, 0.37), on_face}) {
      scene.camera.world_from_cam =
          look_at(eye, Vector3d(0.31, 0.57, 0.63), Vector3d(0.1, 0.2, 1.0));
      const Rendered made = rendered(scene);
      EXPECT_LE(test::error_of_cube(scene, made.pixels), kExact)
          << name_of(type) << ' ' << eye.transpose();
      EXPECT_EQ(made.counts.undecided_rays, 0U) << name_of(type);
    }
  }
}

/// The first node that is no corner is moved for one cell alone.
TEST(CurvedCells, AFaceThatTwoCellsBendOtherwiseIsABorderOfEach) {
  for (const CellType type : test::kBentTypes) {
    CellMesh mesh = bent_cube(type, 2, 0.02);
    const std::size_t n_before = connect_cells(mesh, "cube.vtu").boundary.size();
    EXPECT_EQ(n_before, check_cell_mesh(mesh, "cube.vtu").n_boundary_faces) << name_of(type);
    const CellShape& shape = shape_of(type);
    for (std::size_t e = 0; e < shape.edges.size(); ++e) {
      const std::size_t node = shape.n_corners + e * shape.on_edge;
      const Vector3d at = mesh.points[mesh.nodes[node]];
      if (at.minCoeff() > 0.0 && at.maxCoeff() < 1.0) {
        mesh.nodes[node] = static_cast<std::uint32_t>(mesh.points.size());
        mesh.points.emplace_back(at + Vector3d(0.01, 0.0, 0.0));
        break;
      }
    }
    EXPECT_GE(connect_cells(mesh, "cube.vtu").boundary.size(), n_before + 4) << name_of(type);
  }
}

TEST(CurvedCells, ProjectionRefusesThemAndNamesTheCure) {
  for (const CellType type : test::kBentTypes) {
    const VolumeScene scene = test::scene_of(bent_cube(type, 1, 0.05));
    try {
      static_cast<void>(test::project(scene));
      FAIL() << "no error";
    } catch (const Error& error) {
      EXPECT_NE(error.problem().find("cell 0 is a " + name_of(type) + " with a bent edge"),
                std::string::npos)
          << error.what();
      EXPECT_NE(std::string(error.what()).find("--algorithm ray-casting"), std::string::npos);
    }
  }
}

/// What bounds a field in a cell (cell_projection.cpp), and is reached in one of 20 nodes.
TEST(CurvedCells, NodesThatAreNoCornersWeighThreeAtMost) {
  double most = 0.0;
  constexpr int kSteps = 24;
  for (const CellType type : test::kBentTypes) {
    for (int i = 0; i <= kSteps * kSteps * kSteps; ++i) {
      const Vector3d at =
          Eigen::Vector3i(i % kSteps, i / kSteps % kSteps, i / kSteps / kSteps).cast<double>() /
          kSteps;
      if (depth_within(type, at) < 0.0) {
        continue;
      }
      ShapeFunctions shape;
      find_shape(type, at, shape);
      double sum = 0.0;
      for (std::size_t node = shape_of(type).n_corners; node < shape_of(type).n_nodes; ++node) {
        sum += std::abs(shape.weights.at(node));
      }
      EXPECT_LE(sum, 3.0 + 1e-14) << name_of(type) << ' ' << at.transpose();
      most = std::max(most, sum);
    }
  }
  EXPECT_NEAR(most, 3.0, 1e-14);
}

/// Random patches of each form, and rays through a point of them by their shape functions.
TEST(CurvedFaces, PassAtThePointsOfTheirShapeFunctions) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> number(-0.1, 0.1);
  for (const CellType type : test::kBentTypes) {
    int n_found = 0;
    for (int trial = 0; trial < 100; ++trial) {
      VolumeScene scene = test::scene_of(test::cube_of(type, 1));
      for (Vector3d& point : scene.mesh.points) {
        point += 0.5 * Vector3d(number(random), number(random), number(random));
      }
      const std::size_t side = static_cast<std::size_t>(trial) % shape_of(type).faces.size();
      const CellFace face{
          .nodes = {}, .corners = {}, .bent_side = static_cast<std::uint8_t>(side)};
      const double u = 0.35 + number(random);
      const double v = 0.35 + number(random);
      const bool is_square = nodes_of_bent(scene.mesh, 0, face).n_corners() == 4;
      const std::array<double, 4> weights =
          is_square ? std::array{(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v}
                    : std::array{1 - u - v, u, v, 0.0};
      ShapeFunctions shape;
      find_shape(type, coordinates_on_face(type, side, weights), shape);
      Vector3d at = Vector3d::Zero();
      for (std::size_t i = 0; i < shape_of(type).n_nodes; ++i) {
        at += shape.weights.at(i) * scene.mesh.points[scene.mesh.nodes_of(0)[i]];
      }
      scene.optics.pixel_mm = 0.0;
      scene.camera.world_from_cam =
          look_at(Vector3d(2.9, -1.7, 2.3), Vector3d(0.5, 0.4, 0.6), Vector3d::UnitZ());
      const VolumeView view(scene, FaceForm::general);
      const Vector3d seen = scene.camera.world_from_cam.inverse() * at;
      std::vector<BentCrossing> crossings;
      const Vector2d ray = seen.head<2>() / seen.z();
      if (!add_bent_crossings(view, ray, Vector2d::Zero(), nodes_of_bent(scene.mesh, 0, face),
                              crossings)) {
        continue;  // seen edge-on
      }
      const auto is_it = [&](const BentCrossing& crossing) {
        return std::abs(crossing.z - seen.z()) < 1e-11 &&
               std::abs(crossing.weights[1] - weights[1]) < 1e-11 &&
               std::abs(crossing.weights[2] - weights[2]) < 1e-11;
      };
      EXPECT_EQ(std::ranges::count_if(crossings, is_it), 1)
          << name_of(type) << ' ' << trial << ' ' << crossings.size();
      ++n_found;
    }
    EXPECT_GE(n_found, 95) << name_of(type);
  }
}

}  // namespace
}  // namespace haarlight::render
