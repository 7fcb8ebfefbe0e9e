// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "render/cell_mesh/cell_mesh.h"

/// @file
/// The triangles that bound cells, and which cells lie beside which.
///
/// A face of four corners is two triangles, parted from its corner of the smallest number: two cells
/// that share it part it alike. Where it is not flat the triangles, not the bilinear patch, are the
/// border of both.
///
/// Of a quadratic tetrahedron with bent edges a face with a bent edge is the curved patch through its
/// six nodes (bent_face.h); its other faces are the triangles that they are.

namespace haarlight::render {

inline constexpr std::uint32_t kNoCell = std::numeric_limits<std::uint32_t>::max();

struct CellFace {
  std::array<std::uint32_t, 3> nodes;     ///< points, anticlockwise seen from outside
  std::uint32_t neighbour = kNoCell;      ///< the cell beyond it
  std::array<std::uint8_t, 3> corners{};  ///< the nodes, as numbers within the cell
  bool is_bent = false;                   ///< has a bent edge
};

/// Faces in half the memory, of cells that are tetrahedra, all of them.
struct Tetrahedron {
  std::array<std::uint32_t, 4> nodes;
  /// Of node i the cell beyond the face opposite to it; kNoCell: none.
  std::array<std::uint32_t, 4> neighbours;
};

/// A face of one cell only.
struct BoundaryFace {
  std::array<std::uint32_t, 3> nodes;  ///< as CellFace
  std::uint32_t cell = 0;
  std::uint32_t number = kNoCell;  ///< in CellFaces::faces, where those are not empty
};

struct CellFaces {
  std::vector<Tetrahedron> tetrahedra;  ///< in the mesh's order; empty: not all are
  std::vector<std::uint32_t> begins;    ///< else (n_cells + 1,), of each cell's `faces`
  std::vector<CellFace> faces;
  std::vector<BoundaryFace> boundary;
  /// (n_cells,) whether the cell is a quadratic tetrahedron with a bent edge; empty: none is.
  std::vector<bool> is_bent;

  [[nodiscard]] bool is_bent_cell(std::uint32_t cell) const {
    return !is_bent.empty() && is_bent[cell];
  }
};

enum class FaceForm : bool { tetrahedra_where_all_are, general };

/// @param mesh  sound: check_cell_mesh() @param file  for errors
/// @throws Error  a face that more than two cells share. O(cells)
/// Two cells whose common face is bent must have its six nodes at the same points, else it counts as a
/// face of each alone.
[[nodiscard]] CellFaces connect_cells(const CellMesh& mesh, const std::string& file,
                                      FaceForm form = FaceForm::tetrahedra_where_all_are);

/// The six nodes of a bent face: its corners as they stand there, then the middles of 01 12 20.
[[nodiscard]] std::array<std::uint32_t, 6> nodes_of_bent(const CellMesh& mesh,
                                                         std::uint32_t cell,
                                                         const CellFace& face);

/// @throws Error  a quadratic tetrahedron with a node off the middle of its edge, by its number in
///                the file: for what renders straight cells alone
void require_straight(const CellMesh& mesh, const std::string& file);

}  // namespace haarlight::render
