// SPDX-License-Identifier: Apache-2.0
#include "render/cell_mesh/cell_mesh_check.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <random>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "render/cell_mesh/shape_functions.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using ::testing::HasSubstr;

/// Cells of one type over given points, each after the one before.
CellMesh mesh_of(std::vector<Vector3d> points, CellType type,
                 std::vector<std::uint32_t> nodes) {
  CellMesh mesh;
  mesh.points = std::move(points);
  mesh.nodes = std::move(nodes);
  for (std::size_t at = 0; at < mesh.nodes.size(); at += shape_of(type).n_nodes) {
    mesh.types.push_back(type);
    mesh.begins.push_back(at);
  }
  return mesh;
}

const std::vector<Vector3d> kCube = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0},
                                     {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}};

/// x² + ... of a straight tetrahedron's edge middles, after its corners.
std::vector<Vector3d> quadratic_points() {
  std::vector<Vector3d> x = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  for (const auto& [a, b] : {std::pair(0, 1), std::pair(1, 2), std::pair(2, 0), std::pair(0, 3),
                             std::pair(1, 3), std::pair(2, 3)}) {
    x.emplace_back(0.5 * (x[static_cast<std::size_t>(a)] + x[static_cast<std::size_t>(b)]));
  }
  return x;
}

TEST(CellShapes, FacesAreClosedAndPointOutwards) {
  // Of each type a cell around the middle of its nodes: every edge is walked once each way, and
  // every face's normal points away from the middle.
  const std::vector<std::pair<CellType, std::vector<std::uint32_t>>> cells = {
      {CellType::tetrahedron, {0, 1, 3, 4}},
      {CellType::hexahedron, {0, 1, 2, 3, 4, 5, 6, 7}},
      {CellType::wedge, {0, 1, 3, 4, 5, 7}},
      {CellType::pyramid, {0, 1, 2, 3, 6}}};
  for (const auto& [type, nodes] : cells) {
    const CellShape& shape = shape_of(type);
    SCOPED_TRACE(shape.name);
    Vector3d middle = Vector3d::Zero();
    for (const std::uint32_t node : nodes) {
      middle += kCube[node] / static_cast<double>(nodes.size());
    }
    Eigen::MatrixXi walks = Eigen::MatrixXi::Zero(8, 8);
    for (const auto& face : shape.faces) {
      const std::size_t n = face[3] == kNone ? 3 : 4;
      for (std::size_t c = 0; c < n; ++c) {
        ++walks(face.at(c), face.at((c + 1) % n));
      }
      const Vector3d& a = kCube[nodes[face[0]]];
      const Vector3d normal = (kCube[nodes[face[1]]] - a).cross(kCube[nodes[face[2]]] - a);
      EXPECT_GT(normal.dot(a - middle), 0.0);
    }
    EXPECT_EQ(walks, walks.transpose());
    EXPECT_LE(walks.maxCoeff(), 1);
  }
}

TEST(CellVolume, OfEveryTypeIsThatOfItsSolid) {
  EXPECT_EQ(cell_volume(mesh_of(kCube, CellType::hexahedron, {0, 1, 2, 3, 4, 5, 6, 7}), 0),
            1.0);
  EXPECT_EQ(cell_volume(mesh_of(kCube, CellType::wedge, {0, 1, 3, 4, 5, 7}), 0), 0.5);
  EXPECT_NEAR(cell_volume(mesh_of(kCube, CellType::pyramid, {0, 1, 2, 3, 6}), 0), 1.0 / 3,
              1e-16);
  EXPECT_NEAR(cell_volume(mesh_of(kCube, CellType::tetrahedron, {0, 1, 3, 4}), 0), 1.0 / 6,
              1e-16);
}

TEST(CellVolume, OfABilinearFaceIsTheIntegralOfItsHeight) {
  // The lid's height over (x, y) is 1 + h x y: the volume is 1 + h/4.
  std::vector<Vector3d> points = kCube;
  points[6].z() = 1.0 + 0.75;
  EXPECT_NEAR(cell_volume(mesh_of(points, CellType::hexahedron, {0, 1, 2, 3, 4, 5, 6, 7}), 0),
              1.0 + 0.75 / 4, 1e-15);
}

TEST(CellVolume, OfAQuadraticTetrahedronFollowsItsBentEdges) {
  std::vector<Vector3d> points = quadratic_points();
  const std::vector<std::uint32_t> nodes = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9};
  EXPECT_NEAR(cell_volume(mesh_of(points, CellType::quadratic_tetrahedron, nodes), 0), 1.0 / 6,
              1e-16);
  // Node 4 lifted by h along z: det J = 1 + h d(4 L0 L1)/dz, L0 = 1 - x - y - z, L1 = x; the
  // integral of 1 - 4 h x over the tetrahedron is 1/6 - 4 h / 24.
  points[4].z() = 0.03;
  EXPECT_NEAR(cell_volume(mesh_of(points, CellType::quadratic_tetrahedron, nodes), 0),
              1.0 / 6 - 0.03 / 6, 1e-16);
}

TEST(CheckCellMesh, CountsFacesPartsAndUnusedPoints) {
  std::vector<Vector3d> points = kCube;
  points.insert(points.end(),
                {{2, 0, 0}, {2, 1, 0}, {2, 0, 1}, {2, 1, 1}, {9, 9, 9}, {8, 0, 0}});
  for (const Vector3d& point : kCube) {
    points.emplace_back(point + Vector3d(4, 0, 0));
  }
  const MeshCheck check =
      check_cell_mesh(mesh_of(points, CellType::hexahedron, {0,  1,  2,  3,  4,  5,  6,  7,  //
                                                             1,  8,  9,  2,  5,  10, 11, 6,  //
                                                             14, 15, 16, 17, 18, 19, 20, 21}),
                      "t");
  EXPECT_EQ(check.n_of_type[1], 3U);
  EXPECT_EQ(check.n_faces, 17U);
  EXPECT_EQ(check.n_boundary_faces, 16U);
  EXPECT_EQ(check.n_crowded_faces, 0U);
  EXPECT_EQ(check.n_parts, 2U);
  EXPECT_EQ(check.n_unused_points, 2U);
  EXPECT_EQ(check.volume, 3.0);
  EXPECT_EQ(check.low, Vector3d(0, 0, 0));
  EXPECT_EQ(check.high, Vector3d(9, 9, 9));
  EXPECT_EQ(check.n_non_planar_faces, 0U);
}

TEST(CheckCellMesh, MeasuresFacesOffTheirPlaneAndBentEdges) {
  std::vector<Vector3d> points = kCube;
  points[6] = {1.0, 1.0, 1.4};
  const MeshCheck hexahedron =
      check_cell_mesh(mesh_of(points, CellType::hexahedron, {0, 1, 2, 3, 4, 5, 6, 7}), "t");
  EXPECT_EQ(hexahedron.n_non_planar_faces, 1U);
  // Corners at heights 0 0 0.4 0: normal (-0.2, -0.2, 1), each corner 0.1 above or below.
  EXPECT_NEAR(hexahedron.largest_deviation, 0.1 / std::sqrt(1.08), 1e-15);
  std::vector<Vector3d> bent = quadratic_points();
  bent[7] += Vector3d(0.0, 0.01, 0.0);
  const MeshCheck quadratic = check_cell_mesh(
      mesh_of(bent, CellType::quadratic_tetrahedron, {0, 1, 2, 3, 4, 5, 6, 7, 8, 9}), "t");
  EXPECT_EQ(quadratic.n_curved_cells, 1U);
  EXPECT_NEAR(quadratic.largest_bend, 0.01, 1e-16);
}

/// The node between corners 0 and 1 at (m, 0, 0): along that edge det J is 4 m - 1 at corner 0, 3 - 4 m at
/// corner 1, and linear between them.
TEST(CheckCellMesh, RefusesBentCellsThatAreFoldedAnywhere) {
  const auto cell = [](double m) {
    std::vector<Vector3d> points = quadratic_points();
    points[4] = {m, 0.0, 0.0};
    return mesh_of(points, CellType::quadratic_tetrahedron, {0, 1, 2, 3, 4, 5, 6, 7, 8, 9});
  };
  for (const double m : {0.251, 0.4, 0.5, 0.6, 0.749}) {
    EXPECT_EQ(folding_of(cell(m), 0), Folding::none) << m;
  }
  for (const double m : {0.1, 0.249, 0.751, 0.9}) {
    EXPECT_EQ(folding_of(cell(m), 0), Folding::folded) << m;
  }
  for (const double m : {0.25, 0.75}) {  // flat at a corner
    EXPECT_EQ(folding_of(cell(m), 0), Folding::too_near_to_tell) << m;
  }
  try {
    static_cast<void>(check_cell_mesh(cell(0.2), "t"));
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), HasSubstr("cell 0, a quadratic tetrahedron, is folded"));
  }
}

/// The cell whose corners are those of the unit cube, of its half, of the pyramid over (1/2, 1/2, 1), or of the
/// simplex, straight.
CellMesh one_cell(CellType type) {
  const CellShape& shape = shape_of(type);
  std::vector<Vector3d> points;
  switch (shape.linear) {
    case CellType::tetrahedron:
      points = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
      break;
    case CellType::wedge:
      points = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1}, {0, 1, 1}};
      break;
    case CellType::pyramid:
      points = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}, {0.5, 0.5, 1}};
      break;
    default:
      points = kCube;
  }
  for (const auto& [a, b] : shape.edges) {
    for (std::size_t k = 1; k <= shape.on_edge; ++k) {
      const double s = static_cast<double>(k) / static_cast<double>(shape.on_edge + 1);
      points.emplace_back((1.0 - s) * points[a] + s * points[b]);
    }
  }
  std::map<std::size_t, Vector3d> middles;  // by their number
  for (std::size_t side = 0; side < shape.in_faces.size(); ++side) {
    Vector3d sum = Vector3d::Zero();
    const double n = shape.faces[side][3] == kNone ? 3.0 : 4.0;
    for (const std::uint8_t corner : shape.faces[side]) {
      sum += corner == kNone ? Vector3d::Zero() : points[corner];
    }
    middles[shape.in_faces[side]] = sum / n;
  }
  for (const auto& [node, middle] : middles) {
    points.push_back(middle);
  }
  if (shape.centre != kNone) {
    points.emplace_back(0.5, 0.5, 0.5);
  }
  std::vector<std::uint32_t> nodes(points.size());
  std::iota(nodes.begin(), nodes.end(), 0U);
  return mesh_of(points, type, nodes);
}

constexpr auto kBentTypes =
    std::to_array<CellType>({CellType::quadratic_tetrahedron, CellType::quadratic_hexahedron,
                             CellType::triquadratic_hexahedron, CellType::quadratic_wedge,
                             CellType::quadratic_pyramid, CellType::cubic_tetrahedron});

/// The first node on the edge from corner 0 to corner 1 at (m, 0, 0). Quadratic cells: as above, along that
/// edge. The cubic one: the edge's slope is 1 + 9/2 (m - 1/3) (2 - 10 r + 9 r^2): least at 0 or at 5/9.
TEST(CheckCellMesh, RefusesBentCellsOfAllTypesByName) {
  for (const CellType type : kBentTypes) {
    SCOPED_TRACE(std::string(shape_of(type).name));
    const bool is_cubic = type == CellType::cubic_tetrahedron;
    const double low = is_cubic ? 2.0 / 9.0 : 0.25;
    const double high = is_cubic ? 1.0 / 3.0 + 2.0 / 7.0 : 0.75;
    const auto cell = [type](double m) {
      CellMesh mesh = one_cell(type);
      mesh.points[shape_of(type).n_corners] = {m, 0.0, 0.0};
      return mesh;
    };
    for (const double m : {low + 1e-3, 0.4, high - 1e-3}) {
      EXPECT_EQ(folding_of(cell(m), 0), Folding::none) << m;
    }
    for (const double m : {low - 1e-3, high + 1e-3}) {
      EXPECT_EQ(folding_of(cell(m), 0), Folding::folded) << m;
    }
    EXPECT_EQ(folding_of(cell(low), 0), Folding::too_near_to_tell);
    try {
      static_cast<void>(check_cell_mesh(cell(low - 1e-3), "t"));
      ADD_FAILURE() << "no error";
    } catch (const Error& error) {
      EXPECT_THAT(error.problem(),
                  HasSubstr("cell 0, a " + std::string(shape_of(type).name) + ", is folded"));
    }
  }
}

/// Against a Jacobian's values at a great number of points: what is proved to have no fold has none there, and what
/// is folded has one.
TEST(CheckCellMesh, FoldsAreThoseOfRandomCells) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> number(-1.0, 1.0);
  for (const CellType type : kBentTypes) {
    int n_folded = 0;
    for (int trial = 0; trial < 30; ++trial) {
      CellMesh mesh = one_cell(type);
      const double most = 0.04 * (1 + trial % 6);
      for (Vector3d& point : mesh.points) {
        point += most * Vector3d(number(random), number(random), number(random));
      }
      double least = 1e9;
      ShapeFunctions shape;
      constexpr int kSide = 8;
      for (int i = 0; i < kSide * kSide * kSide; ++i) {
        const Vector3d rst =
            Eigen::Vector3i(i % kSide, i / kSide % kSide, i / (kSide * kSide)).cast<double>() /
            (kSide - 1.0);
        if (depth_within(type, rst) < 0.0 ||
            (type == CellType::quadratic_pyramid && rst.z() == 1.0)) {
          continue;
        }
        find_shape(type, rst, shape);
        Eigen::Matrix3d jacobian = Eigen::Matrix3d::Zero();
        for (std::size_t k = 0; k < mesh.points.size(); ++k) {
          jacobian += mesh.points[k] * shape.slopes.at(k).transpose();
        }
        least = std::min(least, jacobian.determinant());
      }
      const Folding folding = folding_of(mesh, 0);
      EXPECT_NE(folding, Folding::too_near_to_tell);
      EXPECT_FALSE(folding == Folding::none && least <= 0.0) << shape_of(type).name << trial;
      n_folded += folding == Folding::folded ? 1 : 0;
    }
    EXPECT_GT(n_folded, 0) << shape_of(type).name;
    EXPECT_LT(n_folded, 30) << shape_of(type).name;
  }
}

/// Weights are 1 at their node and 0 at others, slopes those of differences; straight cells are linear.
TEST(ShapeFunctions, AreOneAtTheirNodes) {
  for (const CellType type : kBentTypes) {
    SCOPED_TRACE(std::string(shape_of(type).name));
    const CellMesh mesh = one_cell(type);
    ShapeFunctions shape;
    for (std::size_t i = 0; i < mesh.points.size(); ++i) {
      Vector3d rst = mesh.points[i];
      if (type == CellType::quadratic_pyramid) {  // over the base it narrows
        const double rest = 1.0 - rst.z();
        rst.head<2>() = rest > 0.0
                            ? Eigen::Vector2d((rst.head<2>().array() - 0.5 * rst.z()) / rest)
                            : Eigen::Vector2d(0.3, 0.8);
      }
      find_shape(type, rst, shape);
      for (std::size_t k = 0; k < mesh.points.size(); ++k) {
        EXPECT_NEAR(shape.weights.at(k), i == k ? 1.0 : 0.0, 1e-15) << i << ' ' << k;
      }
    }
    const Vector3d at(0.2, 0.3, 0.4);
    find_shape(type, at, shape);
    ShapeFunctions linear;
    find_shape(shape_of(type).linear, at, linear);
    Vector3d sum = Vector3d::Zero();
    for (std::size_t k = 0; k < mesh.points.size(); ++k) {
      sum += shape.weights.at(k) * mesh.points[k];
      sum -= k < shape_of(type).n_corners ? Vector3d(linear.weights.at(k) * mesh.points[k])
                                          : Vector3d::Zero();
    }
    EXPECT_LE(sum.norm(), 1e-15);
    for (int axis = 0; axis < 3; ++axis) {
      constexpr double kStep = 1e-5;
      ShapeFunctions before;
      ShapeFunctions after;
      find_shape(type, at - kStep * Vector3d::Unit(axis), before);
      find_shape(type, at + kStep * Vector3d::Unit(axis), after);
      for (std::size_t k = 0; k < mesh.points.size(); ++k) {
        EXPECT_NEAR(shape.slopes.at(k)[axis],
                    (after.weights.at(k) - before.weights.at(k)) / (2.0 * kStep), 1e-8);
      }
    }
  }
}

/// The lid's middle nodes lifted: a paraboloid, of known volume.
TEST(CellVolume, OfAQuadraticHexahedronUnderAParaboloid) {
  CellMesh mesh = one_cell(CellType::triquadratic_hexahedron);
  mesh.points[25].z() +=
      0.09;  // the middle of the lid: 0.09 * 16 r (1 - r) s (1 - s) t (2 t - 1)
  EXPECT_NEAR(cell_volume(mesh, 0), 1.0 + 0.09 * 4.0 / 9.0, 1e-15);
  mesh = one_cell(CellType::quadratic_hexahedron);
  mesh.points[12].z() += 0.09;  // an edge of the lid: 4 r (1 - r) (1 - s) t
  EXPECT_NEAR(cell_volume(mesh, 0), 1.0 + 0.09 / 3.0, 1e-15);
  mesh = one_cell(CellType::quadratic_wedge);
  mesh.points[9].z() += 0.09;  // 4 (1 - r - s) r over the triangle: 1/6
  EXPECT_NEAR(cell_volume(mesh, 0), 0.5 + 0.09 / 6.0, 1e-15);
  mesh = one_cell(CellType::quadratic_pyramid);
  // The base, below: 4 r (1 - r) (1 - s); less that of the triangle y = z/2 over it, 4 b b' / 2.
  mesh.points[5].z() -= 0.09;
  EXPECT_NEAR(cell_volume(mesh, 0), 1.0 / 3.0 + 0.09 / 3.0 - 0.09 / 12.0, 1e-15);
  mesh = one_cell(CellType::cubic_tetrahedron);
  mesh.points[19].z() -= 0.03;  // the middle of the base, below: 27 b b' b''
  EXPECT_NEAR(cell_volume(mesh, 0), 1.0 / 6.0 + 0.03 * 27.0 / 120.0, 1e-15);
}

TEST(CheckCellMesh, TakesTheAnvilAndCountsIt) {
  // A hexahedron whose corner 6 is its corner 7.
  const MeshCheck check =
      check_cell_mesh(mesh_of(kCube, CellType::hexahedron, {0, 1, 2, 3, 4, 5, 7, 7}), "t");
  EXPECT_EQ(check.n_collapsed_cells, 1U);
  EXPECT_GT(check.volume, 0.5);
  EXPECT_EQ(check.n_faces, 6U);
}

TEST(CheckCellMesh, ACollapsedFaceIsTheTriangleOfItsNeighbour) {
  std::vector<Vector3d> points = kCube;
  points.emplace_back(0.5, 2.0, 0.3);
  CellMesh mesh = mesh_of(points, CellType::hexahedron, {0, 1, 2, 3, 4, 5, 7, 7});
  mesh.types.push_back(CellType::tetrahedron);
  mesh.begins.push_back(8);
  mesh.nodes.insert(mesh.nodes.end(), {2, 3, 7, 8});
  const MeshCheck check = check_cell_mesh(mesh, "t");
  EXPECT_EQ(check.n_faces, 9U);
  EXPECT_EQ(check.n_boundary_faces, 8U);
}

TEST(CheckCellMesh, SeesAFaceOfThreeCells) {
  std::vector<Vector3d> points = {{0, 0, 0}, {1, 0, 0},  {0, 1, 0},
                                  {0, 0, 1}, {0, 0, -1}, {0, 0, 2}};
  const MeshCheck check = check_cell_mesh(
      mesh_of(points, CellType::tetrahedron, {0, 1, 2, 3, 0, 2, 1, 4, 0, 1, 2, 5}), "t");
  EXPECT_EQ(check.n_crowded_faces, 1U);
}

void expect_refused(const CellMesh& mesh, const std::string& what) {
  try {
    static_cast<void>(check_cell_mesh(mesh, "t.vtu"));
    ADD_FAILURE() << "taken: " << what;
  } catch (const Error& error) {
    EXPECT_THAT(error.problem(), HasSubstr(what));
    EXPECT_EQ(error.where(), "t.vtu");
    EXPECT_FALSE(error.hint().empty());
  }
}

TEST(CheckCellMesh, RefusesByTheCellWhatCannotBeRendered) {
  expect_refused({}, "no solid cells");
  std::vector<Vector3d> points = kCube;
  points[2].y() = std::nan("");
  expect_refused(mesh_of(points, CellType::tetrahedron, {0, 1, 3, 4}), "point 2 is not finite");
  points[2].y() = std::numeric_limits<double>::infinity();
  expect_refused(mesh_of(points, CellType::tetrahedron, {0, 1, 3, 4}), "point 2 is not finite");
  points[2].y() = 1e150;
  expect_refused(mesh_of(points, CellType::tetrahedron, {0, 1, 2, 4}), "too large");
  const std::string second = "cell 1, a tetrahedron, ";
  expect_refused(mesh_of(kCube, CellType::tetrahedron, {0, 1, 3, 4, 0, 1, 3, 8}),
                 second + "names point 8 of 8");
  expect_refused(mesh_of(kCube, CellType::tetrahedron, {0, 1, 3, 4, 0, 3, 1, 4}),
                 second + "is inverted: its volume is -0.167");
  expect_refused(mesh_of(kCube, CellType::tetrahedron, {0, 1, 3, 4, 0, 1, 2, 3}),
                 second + "is flat: its volume is 0");
  expect_refused(mesh_of(kCube, CellType::tetrahedron, {0, 1, 3, 4, 0, 1, 5, 5}),
                 second + "names point 5 twice and is flat");
  expect_refused(mesh_of(kCube, CellType::hexahedron, {4, 5, 6, 7, 0, 1, 2, 3}),
                 "cell 0, a hexahedron, is inverted: its volume is -1");
  points = kCube;
  points[6] = {0.2, 0.2, 0.7};
  expect_refused(mesh_of(points, CellType::hexahedron, {0, 1, 2, 3, 4, 5, 6, 7}),
                 "cell 0, a hexahedron, is inverted at its node 6");
  CellMesh numbered = mesh_of(kCube, CellType::tetrahedron, {0, 3, 1, 4});
  numbered.numbers_in_file = {17};
  expect_refused(numbered, "cell 17, a tetrahedron");
}

TEST(CheckCellMesh, TakesCellsAsThinAsRoundingAllows) {
  // 1e-9 high on a side of 1: seven orders from flat.
  std::vector<Vector3d> points = kCube;
  points[4].z() = 1e-9;
  EXPECT_NEAR(check_cell_mesh(mesh_of(points, CellType::tetrahedron, {0, 1, 3, 4}), "t").volume,
              1e-9 / 6, 1e-24);
}

}  // namespace
}  // namespace haarlight::render
