// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "haarlight/core/error.h"
#include "render/cell_mesh/cell_mesh_check.h"
#include "render/cell_mesh/cell_mesh_io.h"

/// @file
/// What the fuzz targets of the mesh readers share.

namespace haarlight::test {

inline void require(bool holds) {
  if (!holds) {
    std::abort();
  }
}

/// Any bytes either read as a mesh whose parts fit, which the check takes or refuses, or are
/// refused with Error.
template <class Parse>
void read_or_refuse_mesh(const Parse& parse, const std::uint8_t* data, std::size_t size) {
  try {
    const render::CellMesh mesh =
        parse(std::string_view(reinterpret_cast<const char*>(data), size));
    require(mesh.begins.size() == mesh.n_cells());
    for (std::size_t i = 0; i < mesh.n_cells(); ++i) {
      require(mesh.begins[i] + mesh.nodes_of(i).size() <= mesh.nodes.size());
      for (const std::uint32_t node : mesh.nodes_of(i)) {
        require(node < mesh.points.size());
      }
    }
    require(mesh.numbers_in_file.empty() || mesh.numbers_in_file.size() == mesh.n_cells());
    for (const render::MeshField& field : mesh.point_fields) {
      require(field.values.size() == mesh.points.size() * field.n_components);
    }
    for (const render::MeshField& field : mesh.cell_fields) {
      require(field.values.size() == mesh.n_cells() * field.n_components);
    }
    const render::MeshCheck check = render::check_cell_mesh(mesh, "fuzz");
    require(std::isfinite(check.volume) && check.volume > 0.0);
    require(check.n_boundary_faces + check.n_crowded_faces <= check.n_faces);
    require(check.n_parts >= 1 && check.n_parts <= mesh.n_cells());
  } catch (const Error&) {  // NOLINT(bugprone-empty-catch): the only way out for bad bytes
  }
}

}  // namespace haarlight::test
