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
/// Of a cell with nodes beside its corners a face that is bent is the curved patch through its nodes
/// (bent_face.h), one face however many corners it has; its other faces are the triangles that they are.

namespace haarlight::render {

inline constexpr std::uint32_t kNoCell = std::numeric_limits<std::uint32_t>::max();

struct CellFace {
  /// Points, anticlockwise seen from outside; of a bent one of four corners those of the smallest number, the
  /// one opposite to it, and the smaller one of the others: the same for both its cells.
  std::array<std::uint32_t, 3> nodes;
  std::uint32_t neighbour = kNoCell;      ///< the cell beyond it
  std::array<std::uint8_t, 3> corners{};  ///< the nodes, as numbers within the cell
  std::uint8_t bent_side = kNone;         ///< which face of CellShape it is, if bent

  [[nodiscard]] bool is_bent() const noexcept { return bent_side != kNone; }
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
  /// (n_cells,) whether the cell is bent anywhere: bend_of(); empty: none is.
  std::vector<bool> is_bent;

  [[nodiscard]] bool is_bent_cell(std::uint32_t cell) const {
    return !is_bent.empty() && is_bent[cell];
  }
};

enum class FaceForm : bool { tetrahedra_where_all_are, general };

/// @param mesh  sound: check_cell_mesh() @param file  for errors
/// @throws Error  a face that more than two cells share. O(cells)
/// Two cells whose common face is bent must have all its nodes at the same points, and the same surface
/// through them, else it counts as a face of each alone.
[[nodiscard]] CellFaces connect_cells(const CellMesh& mesh, const std::string& file,
                                      FaceForm form = FaceForm::tetrahedra_where_all_are);

/// The nodes of a bent face, points of the mesh, in the order of PatchForm.
struct PatchNodes {
  PatchForm form = PatchForm::quadratic_triangle;
  std::size_t n = 0;
  std::array<std::uint32_t, 10> nodes{};

  [[nodiscard]] std::size_t n_corners() const noexcept {
    return form == PatchForm::quadratic_triangle || form == PatchForm::cubic_triangle ? 3 : 4;
  }
};
[[nodiscard]] PatchNodes nodes_of_bent(const CellMesh& mesh, std::uint32_t cell,
                                       const CellFace& face);

/// A patch whichever of its cells asks: its corners by their numbers.
struct SortedPatch {
  PatchNodes patch;
  std::array<std::uint8_t, 4> order{};  ///< of its corners, in the patch as it was given
  bool is_turned = false;               ///< runs the other way round
};
[[nodiscard]] SortedPatch sorted(const PatchNodes& patch);

/// @throws Error  a bent cell, by its number in the file: for what renders straight cells alone
void require_straight(const CellMesh& mesh, const std::string& file);

}  // namespace haarlight::render
