// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "render/cell_mesh/cell_mesh_io.h"

namespace haarlight::render {

MeshFormat mesh_format(const std::filesystem::path& path) {
  const std::string ending = path.extension().string();
  if (ending == ".vtu") {
    return MeshFormat::vtu;
  }
  if (ending == ".vtk") {
    return MeshFormat::vtk;
  }
  throw Error(fmt::format("no mesh is read from a file that ends in '{}'", ending),
              path.string(), "give a .vtu (VTK's XML) or a .vtk (VTK's legacy format)");
}

CellMesh read_cell_mesh(const std::filesystem::path& path) {
  const MeshFormat format = mesh_format(path);
  const MappedFile file(path);
  const auto bytes = file.bytes();
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  return format == MeshFormat::vtu ? parse_vtu(text, path.string())
                                   : parse_vtk(text, path.string());
}

}  // namespace haarlight::render
