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
/// Tetrahedra and which lie beside which.

namespace haarlight::render {

inline constexpr std::uint32_t kNoCell = std::numeric_limits<std::uint32_t>::max();

/// The nodes opposite to node i of a tetrahedron, anticlockwise seen from outside.
inline constexpr std::array<std::array<std::uint8_t, 3>, 4> kTetrahedronFaces = {
    {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}}};

struct Tetrahedron {
  std::array<std::uint32_t, 4> nodes;
  /// Of node i the cell beyond the face opposite to it; kNoCell: none.
  std::array<std::uint32_t, 4> neighbours;
};

/// A face of one cell only: that opposite to `node`, a number within the cell.
struct BoundaryFace {
  std::uint32_t cell = 0;
  std::uint8_t node = 0;
};

struct Tetrahedra {
  std::vector<Tetrahedron> cells;  ///< in the mesh's order
  std::vector<BoundaryFace> boundary;
};

/// @param mesh  sound: check_cell_mesh() @param file  for errors
/// @throws Error  another type of cell, by its number in the file; a face that more than two cells
///                share. O(cells)
[[nodiscard]] Tetrahedra connect_tetrahedra(const CellMesh& mesh, const std::string& file);

}  // namespace haarlight::render
