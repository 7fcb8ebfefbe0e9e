// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <string_view>
#include <vector>

#include "render/cell_mesh/cell_mesh.h"

/// @file
/// Cells of any type as tetrahedra, for previews alone: pictures that are exact take cells as they are.

namespace haarlight::render {

struct CellTetrahedron {
  std::array<std::uint32_t, 4> nodes;  ///< points of the mesh
  std::uint32_t cell = 0;
};

/// For a message: what cut_into_tetrahedra() does.
inline constexpr std::string_view kTetrahedraOfCells =
    "from their corners of the smallest numbers, quadratic ones into eight";

/// A hexahedron gives six, a wedge three, a pyramid two: its corner of the smallest number with each
/// triangle of the faces that do not have that corner, where a face of four is parted from its own
/// corner of the smallest number. Two cells that share a face part it alike, as cell_faces.h
/// does. A quadratic tetrahedron gives eight: four at its corners and four about the line between the
/// middles of its first edge and of the opposite one.
/// @param mesh  sound: check_cell_mesh()
/// @return  in the cells' order. O(cells)
[[nodiscard]] std::vector<CellTetrahedron> cut_into_tetrahedra(const CellMesh& mesh);

}  // namespace haarlight::render
