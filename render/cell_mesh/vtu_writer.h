// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <variant>
#include <vector>

#include "render/cell_mesh/cell_mesh.h"

/// @file
/// Meshes of cells with values as VTK's unstructured grid (.vtu), which ParaView and other programs
/// of VTK read: XML 1.0, little-endian, appended raw.

namespace haarlight::render {

/// A value per cell.
struct CellValues {
  std::string name;
  std::variant<std::vector<std::uint8_t>, std::vector<float>> values;
};

/// Boxes in single precision: half the bytes of a CellMesh.
struct HexahedralMesh {
  std::vector<std::array<float, 3>> points;  ///< mm
  /// Corners in VTK_HEXAHEDRON's order: the lower side anticlockwise seen from the upper one,
  /// then the upper side.
  std::vector<std::array<std::int32_t, 8>> cells;
  std::vector<CellValues> values;  ///< each of n_cells
};

/// @throws Error              unwritable
/// @throws ContractViolation  a number of values that is not the number of cells
void write_vtu(const HexahedralMesh& mesh, const std::filesystem::path& file);

/// In double precision, so that reading it gives the same mesh: points, cells and fields in their
/// order, wedges in VTK's. What the mesh counts, notes or names by other numbers is not kept.
/// @throws Error              unwritable; a field's name with a character that XML does not have
/// @throws ContractViolation  a number of values that is not the number of points or cells
void write_vtu(const CellMesh& mesh, const std::filesystem::path& file);

}  // namespace haarlight::render
