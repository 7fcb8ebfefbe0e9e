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

using Edge = std::array<std::uint8_t, 2>;
constexpr auto kHexahedronEdges = std::to_array<Edge>({{0, 1},
                                                       {1, 2},
                                                       {2, 3},
                                                       {3, 0},
                                                       {4, 5},
                                                       {5, 6},
                                                       {6, 7},
                                                       {7, 4},
                                                       {0, 4},
                                                       {1, 5},
                                                       {2, 6},
                                                       {3, 7}});
constexpr auto kWedgeEdges = std::to_array<Edge>(
    {{0, 1}, {1, 2}, {2, 0}, {3, 4}, {4, 5}, {5, 3}, {0, 3}, {1, 4}, {2, 5}});
constexpr auto kPyramidEdges =
    std::to_array<Edge>({{0, 1}, {1, 2}, {2, 3}, {3, 0}, {0, 4}, {1, 4}, {2, 4}, {3, 4}});
constexpr auto kInHexahedronFaces = std::to_array<std::uint8_t>({24, 25, 22, 21, 23, 20});
constexpr auto kInTetrahedronFaces = std::to_array<std::uint8_t>({19, 16, 17, 18});

// clang-format off
constexpr std::array<CellShape, kCellTypes> kShapes = {{
    {"tetrahedron", 4, 4, kTetrahedronFaces, kTetrahedronCorners, CellType::tetrahedron, {}, 0, {}, kNone},
    {"hexahedron", 8, 8, kHexahedronFaces, kHexahedronCorners, CellType::hexahedron, {}, 0, {}, kNone},
    {"wedge", 6, 6, kWedgeFaces, kWedgeCorners, CellType::wedge, {}, 0, {}, kNone},
    {"pyramid", 5, 5, kPyramidFaces, kPyramidCorners, CellType::pyramid, {}, 0, {}, kNone},
    {"quadratic tetrahedron", 10, 4, kTetrahedronFaces, kTetrahedronCorners, CellType::tetrahedron, kQuadraticEdges, 1, {}, kNone},
    {"quadratic hexahedron", 20, 8, kHexahedronFaces, kHexahedronCorners, CellType::hexahedron, kHexahedronEdges, 1, {}, kNone},
    {"triquadratic hexahedron", 27, 8, kHexahedronFaces, kHexahedronCorners, CellType::hexahedron, kHexahedronEdges, 1, kInHexahedronFaces, 26},
    {"quadratic wedge", 15, 6, kWedgeFaces, kWedgeCorners, CellType::wedge, kWedgeEdges, 1, {}, kNone},
    {"quadratic pyramid", 13, 5, kPyramidFaces, kPyramidCorners, CellType::pyramid, kPyramidEdges, 1, {}, kNone},
    {"cubic tetrahedron", 20, 4, kTetrahedronFaces, kTetrahedronCorners, CellType::tetrahedron, kQuadraticEdges, 2, kInTetrahedronFaces, kNone},
}};
// clang-format on

double det(const Vector3d& a, const Vector3d& b, const Vector3d& c) {
  return a.dot(b.cross(c));
}

constexpr double kStraight = 1e-12;
constexpr double kOfPosition = 1e-3;  // coordinates are rounded to their own size

/// How far a node is off a position between others, where that is no rounding.
double off_position(const Vector3d& node, const Vector3d& position, double size) {
  const double off = (node - position).norm();
  return off > kStraight * size ? off : 0.0;
}

/// Of the nodes of a cell, or of one of its faces.
class Straightness {
 public:
  Straightness(const CellMesh& mesh, std::size_t i_cell)
      : mesh_(mesh), nodes_(mesh.nodes_of(i_cell)), shape_(shape_of(mesh.types[i_cell])) {}

  [[nodiscard]] double of_edge(std::size_t edge) const {
    const Vector3d& a = at(shape_.edges[edge][0]);
    const Vector3d& b = at(shape_.edges[edge][1]);
    const double size =
        std::max({(b - a).norm(), kOfPosition * a.norm(), kOfPosition * b.norm()});
    double bend = 0.0;
    const std::size_t first = shape_.n_corners + edge * shape_.on_edge;
    for (std::size_t k = 0; k < shape_.on_edge; ++k) {
      const double s = static_cast<double>(k + 1) / static_cast<double>(shape_.on_edge + 1);
      bend = std::max(bend, off_position(at(first + k), (1.0 - s) * a + s * b, size));
    }
    return bend;
  }

  [[nodiscard]] double of_face(std::size_t side) const {
    const Quad& face = shape_.faces[side];
    const std::size_t n = face[3] == kNone ? 3 : 4;
    double bend = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
      bend = std::max(bend, of_edge(edge_between(face.at(i), face.at((i + 1) % n))));
    }
    if (!shape_.in_faces.empty()) {
      bend = std::max(bend, of_middle(shape_.in_faces[side], std::span(face).first(n)));
    }
    if (n == 4) {
      bend = std::max(bend, deviation_of({at(face[0]), at(face[1]), at(face[2]), at(face[3])}));
    }
    return bend;
  }

  [[nodiscard]] double of_centre() const {
    constexpr std::array<std::uint8_t, 8> kAll = {0, 1, 2, 3, 4, 5, 6, 7};
    return shape_.centre == kNone
               ? 0.0
               : of_middle(shape_.centre, std::span(kAll).first(shape_.n_corners));
  }

  [[nodiscard]] std::size_t edge_between(std::uint8_t a, std::uint8_t b) const {
    return static_cast<std::size_t>(
        std::ranges::find_if(shape_.edges,
                             [&](const Edge& edge) {
                               return edge == Edge{a, b} || edge == Edge{b, a};
                             }) -
        shape_.edges.begin());
  }

 private:
  [[nodiscard]] double of_middle(std::uint8_t node,
                                 std::span<const std::uint8_t> corners) const {
    Vector3d mean = Vector3d::Zero();
    double size = 0.0;
    for (const std::uint8_t corner : corners) {
      mean += at(corner) / static_cast<double>(corners.size());
      size = std::max(
          {size, (at(corner) - at(corners[0])).norm(), kOfPosition * at(corner).norm()});
    }
    return off_position(at(node), mean, size);
  }

  [[nodiscard]] const Vector3d& at(std::size_t node) const {
    return mesh_.points[nodes_[node]];
  }

  const CellMesh& mesh_;
  std::span<const std::uint32_t> nodes_;
  const CellShape& shape_;
};

}  // namespace

const CellShape& shape_of(CellType type) { return kShapes.at(static_cast<std::size_t>(type)); }

double cell_volume(const CellMesh& mesh, std::size_t i_cell) {
  const CellShape& shape = shape_of(mesh.types[i_cell]);
  const std::span<const std::uint32_t> nodes = mesh.nodes_of(i_cell);
  if (shape.may_bend()) {
    return bent_volume(mesh, i_cell);
  }
  std::array<Vector3d, 8> x;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    x.at(i) = mesh.points[nodes[i]] - mesh.points[nodes[0]];
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
  const CellShape& shape = shape_of(mesh.types[i_cell]);
  if (!shape.may_bend()) {
    return 0.0;
  }
  const Straightness cell(mesh, i_cell);
  double largest = cell.of_centre();
  for (std::size_t side = 0; side < shape.faces.size(); ++side) {
    largest = std::max(largest, cell.of_face(side));
  }
  return largest;
}

double bend_of_face(const CellMesh& mesh, std::size_t i_cell, std::size_t side) {
  return shape_of(mesh.types[i_cell]).may_bend() ? Straightness(mesh, i_cell).of_face(side)
                                                 : 0.0;
}

double deviation_of(const std::array<Vector3d, 4>& corners) {
  const Vector3d middle = 0.25 * (corners[0] + corners[1] + corners[2] + corners[3]);
  const Vector3d normal = (corners[2] - corners[0]).cross(corners[3] - corners[1]);
  const double length = normal.norm();
  if (!(length > 0.0)) {
    return 0.0;
  }
  double deviation = 0.0;
  double size = 0.0;
  for (const Vector3d& corner : corners) {
    deviation = std::max(deviation, std::abs((corner - middle).dot(normal)) / length);
    size = std::max({size, (corner - middle).norm(), kOfPosition * corner.norm()});
  }
  return deviation > kStraight * size ? deviation : 0.0;
}

FaceNodes nodes_of_face(CellType type, std::size_t side) {
  const CellShape& shape = shape_of(type);
  const Quad& corners = shape.faces[side];
  FaceNodes face;
  const std::size_t n = corners[3] == kNone ? 3 : 4;
  const auto add = [&face](std::uint8_t node) { face.nodes.at(face.n++) = node; };
  for (std::size_t i = 0; i < n; ++i) {
    add(corners.at(i));
  }
  for (std::size_t i = 0; i < n; ++i) {
    const Edge ends = {corners.at(i), corners.at((i + 1) % n)};
    const auto is_it = [&](const Edge& edge) {
      return edge == ends || edge == Edge{ends[1], ends[0]};
    };
    const auto edge = std::ranges::find_if(shape.edges, is_it);
    const auto first = static_cast<std::uint8_t>(
        shape.n_corners + shape.on_edge * static_cast<std::size_t>(edge - shape.edges.begin()));
    for (std::size_t k = 0; k < shape.on_edge; ++k) {
      add(static_cast<std::uint8_t>(first + (*edge == ends ? k : shape.on_edge - 1 - k)));
    }
  }
  if (!shape.in_faces.empty()) {
    add(shape.in_faces[side]);
  }
  face.form =
      n == 4 ? (shape.in_faces.empty() ? PatchForm::serendipity : PatchForm::biquadratic)
             : (shape.on_edge == 1 ? PatchForm::quadratic_triangle : PatchForm::cubic_triangle);
  return face;
}

}  // namespace haarlight::render
