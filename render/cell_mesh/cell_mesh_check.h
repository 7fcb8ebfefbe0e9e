// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <string>

#include "render/cell_mesh/cell_mesh.h"

/// @file
/// Whether a mesh can be rendered, and what stands out in it.

namespace haarlight::render {

/// What is allowed, counted. Faces that meet only in part (sliding interfaces) are not found:
/// both count as boundary.
struct MeshCheck {
  std::array<std::size_t, kCellTypes> n_of_type{};
  Eigen::Vector3d low = Eigen::Vector3d::Zero();  ///< of all points
  Eigen::Vector3d high = Eigen::Vector3d::Zero();
  double volume = 0.0;
  double smallest_volume = 0.0;
  double largest_volume = 0.0;
  std::size_t n_faces = 0;           ///< each once, by its corners
  std::size_t n_boundary_faces = 0;  ///< of one cell
  std::size_t n_crowded_faces = 0;   ///< of more than two cells, which must overlap
  /// Faces of cells without further nodes, with a corner off their Newell plane by more than 1e-12 of their size.
  std::size_t n_non_planar_faces = 0;
  double largest_deviation = 0.0;  ///< of such a corner, in the mesh's unit
  /// Cells with nodes beside their corners for which bend_of() is not 0.
  std::size_t n_curved_cells = 0;
  double largest_bend = 0.0;          ///< the largest of these, in the mesh's unit
  std::size_t n_collapsed_cells = 0;  ///< repeat a node and keep a volume
  std::size_t n_parts = 0;            ///< sets of cells without a common point
  std::size_t n_unused_points = 0;
};

/// @param file    named in errors, with the cell's number in it
/// @throws Error  no cells; a point that is not finite; a cell that names a point that is not
///                there, is flat, or is inverted in whole or at a corner, or, if bent, anywhere.
///                Numbers too large to compute with.
/// Cells that overlap are not found. O(n log n).
[[nodiscard]] MeshCheck check_cell_mesh(const CellMesh& mesh, const std::string& file);

}  // namespace haarlight::render
