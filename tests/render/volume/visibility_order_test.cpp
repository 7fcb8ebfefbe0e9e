// SPDX-License-Identifier: Apache-2.0
/// @file
/// The order in which cells are seen: cases with known constraints, rings of cells, and against what
/// rays meet.

#include "render/volume/visibility_order.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <random>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "haarlight/core/error.h"
#include "tests/render/volume/volume_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

using Pair = std::pair<std::size_t, std::size_t>;

void add_cell(CellMesh& mesh, std::vector<std::uint32_t> nodes) {
  const auto at = [&](std::size_t i) { return mesh.points[nodes[i]]; };
  if (nodes.size() == 4 && (at(1) - at(0)).cross(at(2) - at(0)).dot(at(3) - at(0)) < 0.0) {
    std::swap(nodes[1], nodes[2]);
  }
  mesh.types.push_back(nodes.size() == 4   ? CellType::tetrahedron
                       : nodes.size() == 5 ? CellType::pyramid
                                           : CellType::hexahedron);
  mesh.begins.push_back(mesh.nodes.size());
  mesh.nodes.insert(mesh.nodes.end(), nodes.begin(), nodes.end());
}

/// A picture of all of it: 64 x 64 pixels.
VolumeScene seen_whole(CellMesh mesh, const Vector3d& eye, const Vector3d& target,
                       Projection projection) {
  double radius = 0.0;
  for (const Vector3d& point : mesh.points) {
    radius = std::max(radius, (point - target).norm());
  }
  VolumeScene scene = test::scene_of(std::move(mesh));
  scene.camera.width = scene.camera.height = 64;
  scene.camera.cx = scene.camera.cy = 32.0;
  scene.camera.world_from_cam = look_at(eye, target, Vector3d(0.1, 1.0, 0.2));
  scene.camera.fx = scene.camera.fy = 30.0 * ((eye - target).norm() - radius) / radius;
  scene.optics.pixel_mm = projection == Projection::parallel ? radius / 30.0 : 0.0;
  return scene;
}

VisibilityOrder order_of(const VolumeScene& scene) {
  return visibility_order(VolumeView(scene, FaceForm::general));
}

/// Where each cell is in the order; of cells in pieces nothing.
std::vector<std::size_t> places_of(const VisibilityOrder& order, std::size_t n_cells) {
  std::vector<std::size_t> places(n_cells, n_cells);
  for (std::size_t i = 0; i < order.back_to_front.size(); ++i) {
    places.at(order.back_to_front[i].cell) = i;
  }
  return places;
}

/// All pairs of a case that one order of its cells cannot keep are in named rings.
void expect_constraints(const VisibilityOrder& order, const std::vector<Pair>& behind_before,
                        std::size_t n_cells, const std::string& name) {
  const std::vector<std::size_t> places = places_of(order, n_cells);
  const auto is_cyclic = [&](std::size_t cell) {
    return std::ranges::any_of(order.cyclic, [cell](const CyclicCells& cyclic) {
      return std::ranges::binary_search(cyclic.cells, static_cast<std::uint32_t>(cell));
    });
  };
  for (const auto& [behind, before] : behind_before) {
    if (!is_cyclic(behind) && !is_cyclic(before)) {
      EXPECT_LT(places[behind], places[before]) << name << ' ' << behind << ' ' << before;
    }
  }
}

/// Each of the cycle hides a part of the next.
void expect_cycle(const CyclicCells& cyclic, const std::vector<Pair>& behind_before,
                  const std::string& name) {
  ASSERT_GE(cyclic.cycle.size(), 3U) << name;
  for (std::size_t i = 0; i < cyclic.cycle.size(); ++i) {
    const Pair link(cyclic.cycle[(i + 1) % cyclic.cycle.size()], cyclic.cycle[i]);
    EXPECT_NE(std::ranges::find(behind_before, link), behind_before.end())
        << name << ": " << link.second << " hides no part of " << link.first;
  }
}

/// The picture of rays, without violations.
void expect_the_picture_of_rays(const VolumeScene& scene, const std::string& name) {
  const test::ProjectedPicture picture = test::project(scene);
  EXPECT_EQ(picture.counts.violations, 0U) << name;
  EXPECT_GT(picture.counts.stretches, 0U) << name;
  EXPECT_LE(test::difference(picture.pixels, test::render(scene)), 1e-12) << name;
}

/// Components of a graph of a few nodes: those that reach each other.
std::set<std::set<std::uint32_t>> rings_of(const std::vector<Pair>& behind_before,
                                           std::size_t n) {
  std::vector<std::vector<char>> reaches(n, std::vector<char>(n, 0));
  for (const auto& [behind, before] : behind_before) {
    reaches[before][behind] = 1;
  }
  for (std::size_t k = 0; k < n; ++k) {
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t j = 0; j < n; ++j) {
        reaches[i][j] = static_cast<char>(reaches[i][j] | (reaches[i][k] & reaches[k][j]));
      }
    }
  }
  std::set<std::set<std::uint32_t>> rings;
  for (std::size_t i = 0; i < n; ++i) {
    std::set<std::uint32_t> ring;
    for (std::size_t j = 0; j < n; ++j) {
      if (reaches[i][j] != 0 && reaches[j][i] != 0) {
        ring.insert(static_cast<std::uint32_t>(j));
      }
    }
    if (ring.size() > 1) {
      rings.insert(ring);
    }
  }
  return rings;
}

void expect_rings(const VisibilityOrder& order, const std::vector<Pair>& behind_before,
                  std::size_t n_cells, const std::string& name) {
  std::set<std::set<std::uint32_t>> named;
  for (const CyclicCells& cyclic : order.cyclic) {
    named.insert({cyclic.cells.begin(), cyclic.cells.end()});
    expect_cycle(cyclic, behind_before, name);
    EXPECT_GT(cyclic.n_pieces, cyclic.cells.size()) << name;
  }
  EXPECT_EQ(named, rings_of(behind_before, n_cells)) << name;
  expect_constraints(order, behind_before, n_cells, name);
}

TEST(VisibilityOrder, SharedCasesKeepTheirConstraints) {
  const std::filesystem::path path =
      HAARLIGHT_SOURCE_DIR "/../shared/data/volume/visibility.json";
  if (!std::filesystem::exists(path)) {
    GTEST_SKIP() << "no " << path;
  }
  const nlohmann::json cases = nlohmann::json::parse(std::ifstream(path));
  const auto vector_of = [](const nlohmann::json& list) {
    return Vector3d(list.at(0).get<double>(), list.at(1).get<double>(),
                    list.at(2).get<double>());
  };
  for (const nlohmann::json& item : cases) {
    const auto name = item.at("name").get<std::string>();
    CellMesh mesh;
    for (const nlohmann::json& point : item.at("vertices")) {
      mesh.points.push_back(vector_of(point));
    }
    for (const nlohmann::json& cell : item.at("cells")) {
      add_cell(mesh, cell.get<std::vector<std::uint32_t>>());
    }
    const nlohmann::json& view = item.at("view");
    const bool is_parallel = view.at("type") == "ortho";
    Vector3d middle = Vector3d::Zero();
    for (const Vector3d& point : mesh.points) {
      middle += point / static_cast<double>(mesh.points.size());
    }
    const Vector3d eye = is_parallel ? Vector3d(middle + 100.0 * vector_of(view.at("toward")))
                                     : vector_of(view.at("eye"));
    const VolumeScene scene =
        seen_whole(std::move(mesh), eye, middle,
                   is_parallel ? Projection::parallel : Projection::perspective);
    const VisibilityOrder order = order_of(scene);
    EXPECT_EQ(order.n_outside, 0U) << name;
    EXPECT_EQ(order.cyclic.empty(), item.at("acyclic").get<bool>()) << name;
    expect_rings(order, item.at("constraints").get<std::vector<Pair>>(), scene.mesh.n_cells(),
                 name);
    expect_the_picture_of_rays(scene, name);
  }
  EXPECT_GE(cases.size(), 13U);
}

/// Sticks about the z axis, each of which lies with one end on the next one's other end.
CellMesh ring_of_sticks(std::size_t n) {
  CellMesh mesh;
  for (std::size_t i = 0; i < n; ++i) {
    const double angle =
        2.0 * std::numbers::pi * static_cast<double>(i) / static_cast<double>(n);
    const Eigen::AngleAxisd turn(angle, Vector3d::UnitZ());
    const auto first = static_cast<std::uint32_t>(mesh.points.size());
    for (const Vector3d& corner : {Vector3d(0.75, -2.5, -0.5), Vector3d(0.875, -2.5, -0.52),
                                   Vector3d(0.8125, 2.5, 0.5), Vector3d(0.8, 2.5, 0.625)}) {
      mesh.points.emplace_back(turn * corner);
    }
    add_cell(mesh, {first, first + 1, first + 2, first + 3});
  }
  return mesh;
}

TEST(VisibilityOrder, RingsOfSticksAreNamedAndSplit) {
  for (const std::size_t n : {3U, 4U}) {
    // Seen from above, y up: the end that rises lies over the next stick anticlockwise, or before it.
    std::vector<Pair> behind_before;
    for (std::size_t i = 0; i < n; ++i) {
      behind_before.emplace_back((i + 1) % n, i);
    }
    for (const Projection projection : {Projection::parallel, Projection::perspective}) {
      const VolumeScene scene =
          seen_whole(ring_of_sticks(n), {0.05, -0.1, 9.0}, Vector3d::Zero(), projection);
      const VisibilityOrder order = order_of(scene);
      const std::string name = std::to_string(n) + " sticks";
      expect_rings(order, behind_before, n, name);
      ASSERT_EQ(order.cyclic.size(), 1U) << name;
      EXPECT_EQ(order.cyclic[0].cycle.size(), n) << name;
      expect_the_picture_of_rays(scene, name);
      // From the side there is an order.
      EXPECT_TRUE(
          order_of(seen_whole(ring_of_sticks(n), {9.0, 0.7, 0.2}, Vector3d::Zero(), projection))
              .cyclic.empty());
    }
  }
}

TEST(VisibilityOrder, SeveralRingsAndLargeOnes) {
  CellMesh mesh;
  std::vector<std::size_t> sizes;
  for (const std::size_t n : {5U, 3U, 12U}) {
    const CellMesh ring = ring_of_sticks(n);
    const auto first = static_cast<std::uint32_t>(mesh.points.size());
    for (const Vector3d& point : ring.points) {
      mesh.points.emplace_back(point +
                               Vector3d(6.0 * static_cast<double>(sizes.size()), 0.0, 0.0));
    }
    for (std::size_t i = 0; i < ring.n_cells(); ++i) {
      std::vector<std::uint32_t> nodes(ring.nodes_of(i).begin(), ring.nodes_of(i).end());
      for (std::uint32_t& node : nodes) {
        node += first;
      }
      add_cell(mesh, nodes);
    }
    sizes.push_back(n);
  }
  VolumeScene scene = seen_whole(mesh, {6.0, 0.0, 40.0}, {6.0, 0.0, 0.0}, Projection::parallel);
  const VisibilityOrder order = order_of(scene);
  std::vector<std::size_t> found;
  for (const CyclicCells& cyclic : order.cyclic) {
    found.push_back(cyclic.cells.size());
    EXPECT_GE(cyclic.cycle.size(), 3U);
  }
  EXPECT_EQ(found, sizes);
  expect_the_picture_of_rays(scene, "three rings");
  scene.glow = Glow::own;
  scene.contours = {{.value = 0.1, .opacity = 0.25}, {.value = 0.45, .opacity = 0.5}};
  scene.contour_field = scene.density_field;
  expect_the_picture_of_rays(scene, "three rings with surfaces");
}

/// What a ray meets, from the eye on: a cell after one that it hides, for every ray.
TEST(VisibilityOrder, NoRayMeetsACellBeforeOneThatIsDrawnLater) {
  std::mt19937 random(4);
  const auto draw = [&] { return static_cast<double>(random() % 1000) / 1000.0; };
  std::uint64_t n_stretches = 0;
  for (int i = 0; i < 60; ++i) {
    const auto n = static_cast<unsigned>(2 + random() % 3);
    CellMesh mesh = test::cube_of_tetrahedra(n);
    std::vector<std::size_t> cells(mesh.n_cells());
    for (std::size_t k = 0; k < cells.size(); ++k) {
      cells[k] = k;
    }
    std::ranges::shuffle(cells, random);
    cells.resize(1 + random() % cells.size());
    for (Vector3d& point : mesh.points) {  // less than makes a cell flat
      point += 0.1 / n * (Vector3d(draw(), draw(), draw()) - Vector3d::Constant(0.5));
    }
    const VolumeScene scene =
        seen_whole(test::chosen(mesh, cells),
                   4.0 * Vector3d(draw() - 0.5, draw() - 0.5, draw() - 0.5).normalized(),
                   Vector3d::Constant(0.5),
                   random() % 2 == 0 ? Projection::parallel : Projection::perspective);
    const test::ProjectedPicture picture = test::project(scene);
    n_stretches += picture.counts.stretches;
    EXPECT_EQ(picture.counts.violations, 0U) << i;
    EXPECT_LE(test::difference(picture.pixels, test::render(scene)), 1e-12) << i;
  }
  EXPECT_GT(n_stretches, 100'000U);
}

TEST(VisibilityOrder, EveryCellOnceAndThoseBesideThePictureNever) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(4));
  test::look_at_cube({1.9, 2.2, 3.1}, 32, scene);
  const VisibilityOrder whole = order_of(scene);
  EXPECT_EQ(whole.n_outside, 0U);
  std::set<std::uint32_t> cells;
  for (const OrderedPiece& piece : whole.back_to_front) {
    EXPECT_TRUE(cells.insert(piece.cell).second);
    EXPECT_EQ(piece.n_cuts, 0U);
  }
  EXPECT_EQ(cells.size(), scene.mesh.n_cells());
  scene.camera.fx = scene.camera.fy = 400.0;  // a part of it
  const VisibilityOrder part = order_of(scene);
  EXPECT_GT(part.n_outside, 0U);
  EXPECT_EQ(part.back_to_front.size() + part.n_outside, scene.mesh.n_cells());
  expect_the_picture_of_rays(scene, "a part of the cube");
}

/// A face that is bent, so that rays pass from each of two cells into the other.
TEST(VisibilityOrder, ABentFaceSeenFromBothSidesIsRefused) {
  CellMesh mesh = test::cube_of(CellType::hexahedron, 2);
  VolumeScene scene = test::scene_of(mesh);
  scene.mesh.points[13] += Vector3d(0.15, 0.0, 0.0);  // the middle
  scene.camera.width = scene.camera.height = 64;
  scene.camera.cx = scene.camera.cy = 32.0;
  scene.camera.fx = scene.camera.fy = 64.0;
  scene.camera.world_from_cam =
      look_at({0.5, 0.3, 4.0}, Vector3d::Constant(0.5), Vector3d::UnitY());
  try {
    static_cast<void>(order_of(scene));
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_NE(error.problem().find("bent"), std::string::npos) << error.what();
    EXPECT_NE(error.problem().find("cells "), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace haarlight::render
