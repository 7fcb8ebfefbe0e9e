// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "render/cell_mesh/cell_mesh_io.h"

/// @file
/// How an unformatted PLOT3D file holds its numbers. Nothing in it says so: of all layouts the
/// one is taken whose size is the file's.
///
///     [grids]  i j k [of each grid]                      32-bit integers
///     grid:      x of all points, y, z, [iblank, 32-bit]            for each grid
///     solution:  Mach alpha Reynolds time; density, momentum x, y, z, energy of all points
///
/// With Fortran's record marks each line above (the four numbers and the variables apart, and
/// the number of grids, too) is a record between two 32-bit numbers, its length in bytes.

namespace haarlight::render {

enum class Plot3dKind : std::uint8_t { grid, solution };

struct Plot3dGrid {
  std::array<std::size_t, 3> size{};  ///< points along i, j, k
  std::size_t at = 0;                 ///< its first number: of x, or the Mach number
  std::size_t values_at = 0;          ///< of x, or of the densities
  [[nodiscard]] std::size_t n_points() const { return size[0] * size[1] * size[2]; }
};

struct Plot3dLayout {
  std::endian order = std::endian::big;
  bool has_marks = false;
  bool is_multiple = false;  ///< begins with the number of grids
  bool is_double = false;
  bool has_blanks = false;  ///< of a grid: iblank follows z
  std::vector<Plot3dGrid> grids;
  std::size_t end = 0;  ///< where the layout ends; zero bytes may follow

  [[nodiscard]] std::size_t real_bytes() const { return is_double ? 8 : 4; }
};

/// "big-endian, without record marks, one grid of 40 x 32 x 32, single precision".
[[nodiscard]] std::string text_of(const Plot3dLayout& layout);

/// A layout that ends where the file does goes before one that zero bytes follow; among equals
/// one whose record marks are all right goes before those without.
/// @throws Error  no layout fits, or several: what was tried; a record mark that is not its
///                record's length; text
[[nodiscard]] Plot3dLayout recognise_plot3d(const NamedBytes& file, Plot3dKind kind);

}  // namespace haarlight::render
