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
  quadratic_tetrahedron
};
inline constexpr std::size_t kCellTypes = 5;

/// What a type of cell is made of; node numbers count within the cell.
struct CellShape {
  std::string_view name;
  std::size_t n_nodes = 0;
  std::size_t n_corners = 0;
  /// Corners of each face, anticlockwise from outside; a triangle's fourth is kNone.
  std::span<const std::array<std::uint8_t, 4>> faces;
  /// For each corner that three edges meet in: it, and their other ends, right-handed.
  std::span<const std::array<std::uint8_t, 4>> corners;
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

/// Of the cell between its faces: a face of four corners is the bilinear patch through them, a
/// quadratic tetrahedron is bent as its ten nodes say. In the cube of the mesh's unit; negative
/// if inverted.
[[nodiscard]] double cell_volume(const CellMesh& mesh, std::size_t i_cell);

/// How far a quadratic tetrahedron's nodes are off the middles of their edges, at most, in the mesh's
/// unit; 0 where that is rounding, 1e-12 of the edge's length.
[[nodiscard]] double bend_of(const CellMesh& mesh, std::size_t i_cell);

/// The same of the node on one of its edges. @param edge  as in kQuadraticEdges
[[nodiscard]] double bend_of_edge(const CellMesh& mesh, std::size_t i_cell, std::size_t edge);

/// Whether a quadratic tetrahedron is turned inside out anywhere: the sign of its Jacobian's
/// determinant.
enum class Folding : std::uint8_t { none, folded, too_near_to_tell };
/// Sound: `none` and `folded` are proved, to rounding; by Bernstein coefficients of the determinant, which
/// is between the least and the largest of them, on parts of the cell.
[[nodiscard]] Folding folding_of(const CellMesh& mesh, std::size_t i_cell);

/// The number in kQuadraticEdges of the edge between two corners.
[[nodiscard]] std::size_t edge_between(std::uint8_t a, std::uint8_t b);

}  // namespace haarlight::render
