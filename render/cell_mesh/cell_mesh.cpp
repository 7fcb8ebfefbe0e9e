// SPDX-License-Identifier: Apache-2.0
#include "render/cell_mesh/cell_mesh.h"

#include <algorithm>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace haarlight::render {

namespace {

using Eigen::Vector3d;
using Quad = std::array<std::uint8_t, 4>;

constexpr auto kTetrahedronFaces = std::to_array<Quad>(
    {{0, 2, 1, kNone}, {0, 1, 3, kNone}, {1, 2, 3, kNone}, {0, 3, 2, kNone}});
constexpr auto kTetrahedronCorners = std::to_array<Quad>({{0, 1, 2, 3}});
constexpr auto kHexahedronFaces = std::to_array<Quad>(
    {{0, 3, 2, 1}, {4, 5, 6, 7}, {0, 1, 5, 4}, {1, 2, 6, 5}, {2, 3, 7, 6}, {3, 0, 4, 7}});
constexpr auto kHexahedronCorners = std::to_array<Quad>({{0, 1, 3, 4},
                                                         {1, 2, 0, 5},
                                                         {2, 3, 1, 6},
                                                         {3, 0, 2, 7},
                                                         {4, 7, 5, 0},
                                                         {5, 4, 6, 1},
                                                         {6, 5, 7, 2},
                                                         {7, 6, 4, 3}});
constexpr auto kWedgeFaces = std::to_array<Quad>(
    {{0, 2, 1, kNone}, {3, 4, 5, kNone}, {0, 1, 4, 3}, {1, 2, 5, 4}, {2, 0, 3, 5}});
constexpr auto kWedgeCorners = std::to_array<Quad>(
    {{0, 1, 2, 3}, {1, 2, 0, 4}, {2, 0, 1, 5}, {3, 5, 4, 0}, {4, 3, 5, 1}, {5, 4, 3, 2}});
constexpr auto kPyramidFaces = std::to_array<Quad>(
    {{0, 3, 2, 1}, {0, 1, 4, kNone}, {1, 2, 4, kNone}, {2, 3, 4, kNone}, {3, 0, 4, kNone}});
constexpr auto kPyramidCorners =
    std::to_array<Quad>({{0, 1, 3, 4}, {1, 2, 0, 4}, {2, 3, 1, 4}, {3, 0, 2, 4}});

constexpr std::array<CellShape, kCellTypes> kShapes = {{
    {"tetrahedron", 4, 4, kTetrahedronFaces, kTetrahedronCorners},
    {"hexahedron", 8, 8, kHexahedronFaces, kHexahedronCorners},
    {"wedge", 6, 6, kWedgeFaces, kWedgeCorners},
    {"pyramid", 5, 5, kPyramidFaces, kPyramidCorners},
    {"quadratic tetrahedron", 10, 4, kTetrahedronFaces, kTetrahedronCorners},
}};

double det(const Vector3d& a, const Vector3d& b, const Vector3d& c) {
  return a.dot(b.cross(c));
}

/// The integral of the Jacobian's determinant, of degree 3: five points are exact.
double quadratic_volume(const std::array<Vector3d, 10>& x) {
  double volume = 0.0;
  for (int i_point = 0; i_point < 5; ++i_point) {
    // Barycentric coordinates: the middle, or half of one corner and a sixth of the others.
    Eigen::Vector4d l = Eigen::Vector4d::Constant(i_point == 4 ? 0.25 : 1.0 / 6.0);
    if (i_point < 4) {
      l[i_point] = 0.5;
    }
    Eigen::Matrix<double, 3, 4> dx_dl;
    for (int i = 0; i < 4; ++i) {
      dx_dl.col(i) = (4.0 * l[i] - 1.0) * x.at(static_cast<std::size_t>(i));
    }
    for (std::size_t e = 0; e < kQuadraticEdges.size(); ++e) {
      const auto [a, b] = kQuadraticEdges.at(e);
      dx_dl.col(a) += 4.0 * l[b] * x.at(4 + e);
      dx_dl.col(b) += 4.0 * l[a] * x.at(4 + e);
    }
    const double jacobian = det(dx_dl.col(1) - dx_dl.col(0), dx_dl.col(2) - dx_dl.col(0),
                                dx_dl.col(3) - dx_dl.col(0));
    volume += (i_point == 4 ? -0.8 : 0.45) * jacobian / 6.0;
  }
  return volume;
}

}  // namespace

const CellShape& shape_of(CellType type) { return kShapes.at(static_cast<std::size_t>(type)); }

double cell_volume(const CellMesh& mesh, std::size_t i_cell) {
  const CellShape& shape = shape_of(mesh.types[i_cell]);
  const std::span<const std::uint32_t> nodes = mesh.nodes_of(i_cell);
  std::array<Vector3d, 10> x;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    x.at(i) = mesh.points[nodes[i]] - mesh.points[nodes[0]];
  }
  if (mesh.types[i_cell] == CellType::quadratic_tetrahedron) {
    return quadratic_volume(x);
  }
  // The cones from node 0 over the faces; a bilinear patch halves the tetrahedron between its
  // two pairs of triangles.
  double six_volumes = 0.0;
  for (const Quad& face : shape.faces) {
    const Vector3d& a = x.at(face[0]);
    const Vector3d& b = x.at(face[1]);
    const Vector3d& c = x.at(face[2]);
    if (face[3] == kNone) {
      six_volumes += det(a, b, c);
      continue;
    }
    const Vector3d& d = x.at(face[3]);
    six_volumes += 0.5 * (det(a, b, c) + det(a, c, d) + det(a, b, d) + det(b, c, d));
  }
  return six_volumes / 6.0;
}

double bend_of(const CellMesh& mesh, std::size_t i_cell) {
  constexpr double kStraight = 1e-12;
  constexpr double kOfPosition = 1e-3;  // coordinates are rounded to their own size
  const std::span<const std::uint32_t> nodes = mesh.nodes_of(i_cell);
  double largest = 0.0;
  for (std::size_t e = 0; e < kQuadraticEdges.size(); ++e) {
    const Vector3d& a = mesh.points[nodes[kQuadraticEdges.at(e)[0]]];
    const Vector3d& b = mesh.points[nodes[kQuadraticEdges.at(e)[1]]];
    const double bend = (mesh.points[nodes[4 + e]] - 0.5 * (a + b)).norm();
    const double size =
        std::max({(b - a).norm(), kOfPosition * a.norm(), kOfPosition * b.norm()});
    largest = bend > kStraight * size ? std::max(largest, bend) : largest;
  }
  return largest;
}

}  // namespace haarlight::render
