// SPDX-License-Identifier: Apache-2.0
#include "render/cell_mesh/cell_mesh.h"

#include <algorithm>
#include <limits>

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

/// By the barycentric coordinates 1, 2 and 3.
Eigen::Matrix3d quadratic_jacobian(const std::array<Vector3d, 10>& x,
                                   const Eigen::Vector4d& l) {
  Eigen::Matrix<double, 3, 4> dx_dl;
  for (int i = 0; i < 4; ++i) {
    dx_dl.col(i) = (4.0 * l[i] - 1.0) * x.at(static_cast<std::size_t>(i));
  }
  for (std::size_t e = 0; e < kQuadraticEdges.size(); ++e) {
    const auto [a, b] = kQuadraticEdges.at(e);
    dx_dl.col(a) += 4.0 * l[b] * x.at(4 + e);
    dx_dl.col(b) += 4.0 * l[a] * x.at(4 + e);
  }
  return dx_dl.rightCols<3>().colwise() - dx_dl.col(0);
}

/// Of a part of a cell by the Jacobians at its corners: det J = sum over i, j, k of l_i l_j l_k times the
/// determinant of the columns 1 of J_i, 2 of J_j and 3 of J_k, whose means over the orders of i, j, k are
/// the Bernstein coefficients.
Folding folding_of_part(const std::array<Eigen::Matrix3d, 4>& jacobians, double rounding,
                        int n_halvings) {
  std::array<double, 64> sums{};
  std::array<int, 64> orders{};
  const auto place_of = [](std::array<std::size_t, 3> factors) {
    std::ranges::sort(factors);
    return 16 * factors[0] + 4 * factors[1] + factors[2];
  };
  for (std::size_t i = 0; i < 4; ++i) {
    for (std::size_t j = 0; j < 4; ++j) {
      for (std::size_t k = 0; k < 4; ++k) {
        const std::size_t place = place_of({i, j, k});
        sums.at(place) +=
            det(jacobians.at(i).col(0), jacobians.at(j).col(1), jacobians.at(k).col(2));
        ++orders.at(place);
      }
    }
  }
  double least = std::numeric_limits<double>::infinity();
  for (std::size_t place = 0; place < sums.size(); ++place) {
    if (orders.at(place) > 0) {
      least = std::min(least, sums.at(place) / orders.at(place));
    }
  }
  if (least > rounding) {
    return Folding::none;
  }
  for (const Eigen::Matrix3d& jacobian : jacobians) {
    if (jacobian.determinant() < -rounding) {
      return Folding::folded;
    }
  }
  if (n_halvings == 0) {
    return Folding::too_near_to_tell;
  }
  // Across the edge of its first and last corner; in the parts, it is another edge's turn.
  const Eigen::Matrix3d middle = 0.5 * (jacobians[0] + jacobians[3]);
  const Folding first = folding_of_part({jacobians[0], middle, jacobians[1], jacobians[2]},
                                        rounding, n_halvings - 1);
  return first != Folding::none
             ? first
             : folding_of_part({jacobians[3], middle, jacobians[1], jacobians[2]}, rounding,
                               n_halvings - 1);
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
    const double jacobian = quadratic_jacobian(x, l).determinant();
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

double bend_of_edge(const CellMesh& mesh, std::size_t i_cell, std::size_t edge) {
  constexpr double kStraight = 1e-12;
  constexpr double kOfPosition = 1e-3;  // coordinates are rounded to their own size
  const std::span<const std::uint32_t> nodes = mesh.nodes_of(i_cell);
  const Vector3d& a = mesh.points[nodes[kQuadraticEdges.at(edge)[0]]];
  const Vector3d& b = mesh.points[nodes[kQuadraticEdges.at(edge)[1]]];
  const double bend = (mesh.points[nodes[4 + edge]] - 0.5 * (a + b)).norm();
  const double size =
      std::max({(b - a).norm(), kOfPosition * a.norm(), kOfPosition * b.norm()});
  return bend > kStraight * size ? bend : 0.0;
}

double bend_of(const CellMesh& mesh, std::size_t i_cell) {
  double largest = 0.0;
  for (std::size_t e = 0; e < kQuadraticEdges.size(); ++e) {
    largest = std::max(largest, bend_of_edge(mesh, i_cell, e));
  }
  return largest;
}

Folding folding_of(const CellMesh& mesh, std::size_t i_cell) {
  const std::span<const std::uint32_t> nodes = mesh.nodes_of(i_cell);
  std::array<Vector3d, 10> x;
  for (std::size_t i = 0; i < x.size(); ++i) {
    x.at(i) = mesh.points[nodes[i]] - mesh.points[nodes[0]];
  }
  std::array<Eigen::Matrix3d, 4> jacobians;  // linear between the corners
  double size = 0.0;
  for (int corner = 0; corner < 4; ++corner) {
    jacobians.at(static_cast<std::size_t>(corner)) =
        quadratic_jacobian(x, Eigen::Vector4d::Unit(corner));
    size = std::max(size,
                    jacobians.at(static_cast<std::size_t>(corner)).colwise().norm().maxCoeff());
  }
  constexpr double kRounding = 1e-14;
  constexpr int kHalvings = 24;
  return folding_of_part(jacobians, kRounding * size * size * size, kHalvings);
}

std::size_t edge_between(std::uint8_t a, std::uint8_t b) {
  std::size_t edge = 0;
  while (kQuadraticEdges.at(edge) != std::array{a, b} &&
         kQuadraticEdges.at(edge) != std::array{b, a}) {
    ++edge;
  }
  return edge;
}

}  // namespace haarlight::render
