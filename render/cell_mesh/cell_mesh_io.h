// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "haarlight/core/enum_words.h"
#include "render/cell_mesh/cell_mesh.h"

/// @file
/// Files of unstructured meshes; on bytes in memory: the entry points of the fuzzers.
///
/// - `.vtu`: VTK's XML. UnstructuredGrid of one or more pieces (equal points of two pieces stay
///   two); arrays as ascii, binary (base64), appended as base64 or raw; headers UInt32 and UInt64;
///   plain or vtkZLibDataCompressor; both byte orders.
/// - `.vtk`: VTK's legacy format, versions 1 to 5.1, ASCII and BINARY (big-endian).
///
/// VTK's cells 10 tetrahedron, 11 voxel (as a hexahedron), 12 hexahedron, 13 wedge, 14 pyramid, 24
/// quadratic tetrahedron. Points, lines and surfaces are left out and counted; other solids are
/// refused by name. Values become doubles; whole numbers beyond 2^53 are rounded.
///
/// Memory: nothing is allocated for a count that the bytes do not back. A file of n bytes may
/// hold 64 n + 2^23 values, however compressed or often named: at most 1.5 kB per byte of the
/// file and 200 MB.

namespace haarlight::render {

enum class MeshFormat : std::uint8_t { vtu, vtk };
inline constexpr auto kMeshFormatWords = std::to_array<std::string_view>({"vtu", "vtk"});
constexpr std::span<const std::string_view> words_of(MeshFormat /*tag*/) {
  return kMeshFormatWords;
}

/// @param name    of the file, in errors as name:line, or "name: byte offset" in binary parts
/// @throws Error  whatever is not as the format says; a cell's type that is not read. That the
///                cells are sound check_cell_mesh() tells.
[[nodiscard]] CellMesh parse_vtu(std::string_view bytes, const std::string& name);
[[nodiscard]] CellMesh parse_vtk(std::string_view bytes, const std::string& name);

/// By the ending of its name.
/// @throws Error  another ending
[[nodiscard]] MeshFormat mesh_format(const std::filesystem::path& path);

/// @throws Error  as the parsers; unreadable
[[nodiscard]] CellMesh read_cell_mesh(const std::filesystem::path& path);

}  // namespace haarlight::render
