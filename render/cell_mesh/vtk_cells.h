// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "render/cell_mesh/cell_mesh.h"

/// @file
/// From cells as both of VTK's formats list them to a mesh's.

namespace haarlight::render {

/// One piece of a file. The numbers are as they stand there: not yet whole, not yet in range.
struct VtkPiece {
  std::vector<double> points;  ///< (n, 3)
  std::vector<double> nodes;   ///< of all cells, one after the other
  std::vector<double> ends;    ///< (n_cells,) where each cell's nodes end
  std::vector<double> types;   ///< (n_cells,) VTK's numbers
  std::vector<MeshField> point_fields;
  std::vector<MeshField> cell_fields;
};

/// Appends the piece's points, solid cells, and fields. The first piece decides on the fields.
/// @param where   of the piece's cells, in errors
/// @throws Error  a cell by its number in the file: its type is not read, or it has another
///                number of nodes than its type, or names a point that is not there; fields
///                that are not those of the pieces before
void append_piece(VtkPiece piece, const std::string& where, CellMesh& mesh);

}  // namespace haarlight::render
