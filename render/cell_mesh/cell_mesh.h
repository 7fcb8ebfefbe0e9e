// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

/// @file
/// An unstructured mesh as plain data: points, solid cells that name them, fields over both.
///
/// Nodes of a cell, whatever file they came from; VTK's order but for the wedge:
///
///     tetrahedron            0 1 2 anticlockwise seen from 3 outside of it: (1-0)x(2-0).(3-0) > 0
///     hexahedron             0 1 2 3 the lower side, anticlockwise seen from the upper one,
///                            then 4 5 6 7 over them
///     wedge                  0 1 2 the lower triangle, anticlockwise seen from the upper one,
///                            then 3 4 5 over them
///     pyramid                0 1 2 3 the base, anticlockwise seen from the tip, then the tip 4
///     quadratic tetrahedron  a tetrahedron's 0 1 2 3, then the middles of 01 12 20 03 13 23
///     quadratic hexahedron   a hexahedron's, then the middles of 01 12 23 30, 45 56 67 74, 04 15 26 37
///     triquadratic one       the same, then those of the sides 0473 1265 0154 3762 0321 4567, and its own
///     quadratic wedge        a wedge's, then the middles of 01 12 20, 34 45 53, 03 14 25
///     quadratic pyramid      a pyramid's, then the middles of 01 12 23 30, 04 14 24 34
///     cubic tetrahedron      a tetrahedron's, then two on each edge, the first one's end nearer, in the
///                            order of the quadratic one's; then the middles of 013 123 203 021
///
/// VTK's order of a wedge is 3 4 5 0 1 2 of these, but some programs write gmsh's, which is this
/// one, into VTK's files: readers take both, and count those that are not in VTK's order. A
/// hexahedron may repeat nodes (seven different ones: the anvil) as long as it keeps a volume.

namespace haarlight::render {

enum class CellType : std::uint8_t {
  tetrahedron,
  hexahedron,
  wedge,
  pyramid,
  quadratic_tetrahedron,
  quadratic_hexahedron,
  triquadratic_hexahedron,
  quadratic_wedge,
  quadratic_pyramid,
  cubic_tetrahedron
};
inline constexpr std::size_t kCellTypes = 10;
inline constexpr std::size_t kMostCellNodes = 27;

/// What a type of cell is made of; node numbers count within the cell.
struct CellShape {
  std::string_view name;
  std::size_t n_nodes = 0;
  std::size_t n_corners = 0;
  /// Corners of each face, anticlockwise from outside; a triangle's fourth is kNone.
  std::span<const std::array<std::uint8_t, 4>> faces;
  /// For each corner that three edges meet in: it, and their other ends, right-handed.
  std::span<const std::array<std::uint8_t, 4>> corners;
  /// The type of the same corners without further nodes; itself, of one that has none.
  CellType linear{};
  /// The corners between which the nodes behind the corners are, `on_edge` of them on each.
  std::span<const std::array<std::uint8_t, 2>> edges;
  std::size_t on_edge = 0;
  /// Of each face the node in its middle; empty: none.
  std::span<const std::uint8_t> in_faces;
  std::uint8_t centre = 255;  ///< the node in the cell's middle; kNone: none

  /// Whether it has nodes beside its corners, so that edges may bend.
  [[nodiscard]] bool may_bend() const noexcept { return on_edge > 0; }
};
inline constexpr std::uint8_t kNone = 255;

[[nodiscard]] const CellShape& shape_of(CellType type);

/// The corners between which a quadratic tetrahedron's nodes 4 to 9 are.
inline constexpr std::array<std::array<std::uint8_t, 2>, 6> kQuadraticEdges = {
    {{0, 1}, {1, 2}, {2, 0}, {0, 3}, {1, 3}, {2, 3}}};

/// Numbers over all points or all cells.
struct MeshField {
  std::string name;
  std::size_t n_components = 1;
  std::vector<double> values;  ///< (n, n_components)
};

struct CellMesh {
  std::vector<Eigen::Vector3d> points;  ///< in the file's unit
  std::vector<CellType> types;          ///< (n_cells,)
  std::vector<std::size_t> begins;      ///< (n_cells,) where a cell's nodes begin in `nodes`
  std::vector<std::uint32_t> nodes;     ///< indices of points
  std::vector<MeshField> point_fields;
  std::vector<MeshField> cell_fields;
  /// Of each cell its number in the file, from 0, or gmsh's own; empty: the same as here.
  std::vector<std::size_t> numbers_in_file;
  std::size_t n_left_out = 0;      ///< points, lines and surfaces among the file's cells
  std::size_t n_other_wedges = 0;  ///< were not in the order of their file's format
  std::size_t n_blanked = 0;       ///< cells left out for a corner that the grid blanks
  std::size_t n_turned = 0;        ///< cells of left-handed grids, put in the order above
  /// What the file does not say and was recognised, and what of it was passed over.
  std::vector<std::string> notes;

  [[nodiscard]] std::size_t n_cells() const { return types.size(); }
  [[nodiscard]] std::span<const std::uint32_t> nodes_of(std::size_t i_cell) const {
    return {nodes.data() + begins[i_cell], shape_of(types[i_cell]).n_nodes};
  }
  [[nodiscard]] std::size_t number_in_file(std::size_t i_cell) const {
    return numbers_in_file.empty() ? i_cell : numbers_in_file[i_cell];
  }
};

/// Of the cell between its faces: a face of four corners is the bilinear patch through them, cells with
/// further nodes are bent as these say. In the cube of the mesh's unit; negative if inverted.
[[nodiscard]] double cell_volume(const CellMesh& mesh, std::size_t i_cell);

/// How far a cell's nodes are off where straight edges have them (their middles or thirds; of a node in a
/// face or in the cell the corners' mean), at most, or the corners of one of its faces off a plane, in the
/// mesh's unit; 0 where that is rounding, 1e-12 of the size, and of linear cells.
[[nodiscard]] double bend_of(const CellMesh& mesh, std::size_t i_cell);

/// The same of one of its faces. @param side  in CellShape::faces
[[nodiscard]] double bend_of_face(const CellMesh& mesh, std::size_t i_cell, std::size_t side);

/// How far a face's corners are off the plane through their middle with Newell's normal, at most; 0 where
/// that is rounding, 1e-12 of the size, or where three of them are one.
[[nodiscard]] double deviation_of(const std::array<Eigen::Vector3d, 4>& corners);

/// Whether a bent cell is turned inside out anywhere: the sign of its Jacobian's determinant.
enum class Folding : std::uint8_t { none, folded, too_near_to_tell };
/// Sound: `none` and `folded` are proved, to rounding; by Bernstein coefficients of the determinant, which
/// is between the least and the largest of them, on parts of the cell.
[[nodiscard]] Folding folding_of(const CellMesh& mesh, std::size_t i_cell);

/// Of one with further nodes, by its shape functions (shape_functions.h): exact, to rounding.
[[nodiscard]] double bent_volume(const CellMesh& mesh, std::size_t i_cell);

/// How the surface through a face's nodes is made of them.
enum class PatchForm : std::uint8_t {
  quadratic_triangle,  ///< corners, then the middles of 01 12 20
  cubic_triangle,      ///< corners, two each on 01 12 20, and one in the middle
  serendipity,         ///< four corners, then the middles of 01 12 23 30
  biquadratic          ///< the same, and one in the middle
};
/// The nodes of a face of a cell that may bend, as numbers within the cell; corners as in CellShape::faces.
/// Two cells with the same nodes there have the same surface, and the same fields on it, whatever their
/// types are.
struct FaceNodes {
  PatchForm form = PatchForm::quadratic_triangle;
  std::size_t n = 0;
  std::array<std::uint8_t, 10> nodes{};
};
[[nodiscard]] FaceNodes nodes_of_face(CellType type, std::size_t side);

}  // namespace haarlight::render
