// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "render/volume/cycle_splitting.h"
#include "render/volume/volume_view.h"

/// @file
/// The order in which a mesh's cells are seen: no cell before one that it hides a part of.
///
/// By the obstruction relation [Williams92b]: of two cells that share a face the one on the eye's
/// side of its plane is nearer; and where the mesh is not convex, of a boundary face by which rays
/// leave a cell and one by which they enter another, if the faces overlap on the picture. A ray goes
/// from one cell to the next in one of these two ways, so any order that keeps these relations is
/// right for every ray. It is found in one depth-first search, which also finds all cycles
/// [Tarjan72]; those are named, and broken by splitting cells. Signs of determinants are exact.
/// Why not by sorting depths and moving cells: docs/decisions/0015-order-by-shared-faces.md.

namespace haarlight::render {

/// A cell, or a convex piece of one: the cell where it is within all of its cuts.
struct OrderedPiece {
  std::uint32_t cell = 0;
  std::uint32_t first_cut = 0;  ///< in VisibilityOrder::cuts
  std::uint32_t n_cuts = 0;
};

/// Cells that obstruct each other in a ring, all that hang together (a strongly connected component).
struct CyclicCells {
  std::vector<std::uint32_t> cells;  ///< ascending
  /// One shortest cycle through the first of them: each hides a part of the next, the last of the
  /// first.
  std::vector<std::uint32_t> cycle;
  std::size_t n_pieces = 0;  ///< that they were split into
};

struct VisibilityOrder {
  std::vector<OrderedPiece> back_to_front;  ///< of the cells that the picture may show
  std::vector<HalfSpace> cuts;
  std::vector<CyclicCells> cyclic;  ///< by their first cells
  std::size_t n_outside = 0;        ///< cells beside the picture, or beyond the clipping planes
  std::size_t n_face_relations = 0;   ///< by faces that two cells share
  std::size_t n_other_relations = 0;  ///< by faces of the boundary
  std::size_t n_exact = 0;            ///< signs that took exact arithmetic
  double cpu_seconds = 0.0;           ///< of the thread
};

/// @param view  with faces in the general form (FaceForm::general); cells do not overlap
/// @throws Error  cells of a cycle whose border is bent, or that splitting did not bring into order:
///                by their numbers in the file
/// O(n + pairs of boundary faces that share a part of the picture).
[[nodiscard]] VisibilityOrder visibility_order(const VolumeView& view);

/// For a message: "cells 3, 7 and 9 hide parts of each other in a ring".
[[nodiscard]] std::string name_of(const CyclicCells& cyclic, const VolumeView& view);

}  // namespace haarlight::render
