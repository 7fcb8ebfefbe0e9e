// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <optional>
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
/// - `.msh`: gmsh's, version 4.1, text and binary (both byte orders). Cells and points keep the
///   file's order, whatever their tags; numbers_in_file are the elements' tags. $NodeData and
///   $ElementData become fields by their first string tag, with ", step N" behind it where there
///   are several steps; each cell and each node of a cell must have a value, other nodes without
///   one get NaN. $ElementNodeData are refused, other sections skipped.
/// - PLOT3D: a grid of points (i fastest, then j, k), unformatted, and the solution on it; both
///   byte orders, with or without Fortran's record marks (of 4 bytes), one grid or several,
///   single or double precision, with or without iblank: recognised in each of the two files
///   by its size alone, where one reading fits it, else refused. Zero bytes behind the end are
///   passed over. notes say what was recognised, and the first grid's free stream. The solution's variables become point fields:
///   "density", "momentum" (3 components) and "energy" (stagnation energy per volume), as
///   PLOT3D scales them. Cells with a corner of iblank 0 are left out and counted (negative
///   ones, of overset grids, are kept); cells count through all grids, from 0, i fastest.
///
/// VTK's cells 10 tetrahedron, 11 voxel (as a hexahedron), 12 hexahedron, 13 wedge, 14 pyramid, 24
/// quadratic tetrahedron; gmsh's 4 tetrahedron, 5 hexahedron, 6 prism (a wedge), 7 pyramid, 11
/// quadratic tetrahedron (its last two nodes are the other way round). Points, lines and
/// surfaces are left out and counted; other solids are refused by name. Values become doubles;
/// whole numbers beyond 2^53 are rounded.
///
/// Memory: nothing is allocated for a count that the bytes do not back. A file of n bytes may
/// hold 64 n + 2^23 values, however compressed or often named: at most 1.5 kB per byte of the
/// file and 200 MB.

namespace haarlight::render {

enum class MeshFormat : std::uint8_t { vtu, vtk, msh, plot3d };
inline constexpr auto kMeshFormatWords =
    std::to_array<std::string_view>({"vtu", "vtk", "msh", "plot3d"});
constexpr std::span<const std::string_view> words_of(MeshFormat /*tag*/) {
  return kMeshFormatWords;
}

/// @param name    of the file, in errors as name:line, or "name: byte offset" in binary parts
/// @throws Error  whatever is not as the format says; a cell's type that is not read. That the
///                cells are sound check_cell_mesh() tells.
[[nodiscard]] CellMesh parse_vtu(std::string_view bytes, const std::string& name);
[[nodiscard]] CellMesh parse_vtk(std::string_view bytes, const std::string& name);
[[nodiscard]] CellMesh parse_msh(std::string_view bytes, const std::string& name);

/// A file of a pair.
struct NamedBytes {
  std::string_view bytes;
  std::string name;
};
/// @throws Error  as above; a solution that is not of the grid's size
[[nodiscard]] CellMesh parse_plot3d(const NamedBytes& grid,
                                    const std::optional<NamedBytes>& solution);

/// By the ending of its name: .vtu, .vtk, .msh; .xyz, .x, .g and .p3d are PLOT3D grids.
/// @throws Error  another ending
[[nodiscard]] MeshFormat mesh_format(const std::filesystem::path& path);

/// What a path alone does not tell.
struct MeshFileOptions {
  std::optional<MeshFormat> format;  ///< nothing: mesh_format() of the path
  std::filesystem::path solution;    ///< of a PLOT3D grid, its q file; empty: none
};

/// @throws Error  as the parsers; unreadable; a solution to another format than PLOT3D
[[nodiscard]] CellMesh read_cell_mesh(const std::filesystem::path& path,
                                      const MeshFileOptions& options = {});

}  // namespace haarlight::render
