// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "render/cell_mesh/cell_mesh_io.h"

namespace haarlight::render {

namespace {

NamedBytes named(const MappedFile& file, const std::filesystem::path& path) {
  const auto bytes = file.bytes();
  return {.bytes = {reinterpret_cast<const char*>(bytes.data()), bytes.size()},
          .name = path.string()};
}

}  // namespace

MeshFormat mesh_format(const std::filesystem::path& path) {
  constexpr std::array<std::pair<std::string_view, MeshFormat>, 7> kEndings = {
      {{".vtu", MeshFormat::vtu},
       {".vtk", MeshFormat::vtk},
       {".msh", MeshFormat::msh},
       {".xyz", MeshFormat::plot3d},
       {".x", MeshFormat::plot3d},
       {".g", MeshFormat::plot3d},
       {".p3d", MeshFormat::plot3d}}};
  const std::string ending = path.extension().string();
  const auto* const found = std::find_if(
      kEndings.begin(), kEndings.end(), [&](const auto& item) { return item.first == ending; });
  if (found == kEndings.end()) {
    throw Error(fmt::format("no mesh is read from a file that ends in '{}'", ending),
                path.string(),
                "give a .vtu (VTK's XML), .vtk (VTK's legacy format), .msh (gmsh) or .xyz "
                "(PLOT3D), or say its format: --format plot3d");
  }
  return found->second;
}

CellMesh read_cell_mesh(const std::filesystem::path& path, const MeshFileOptions& options) {
  const MeshFormat format = options.format ? *options.format : mesh_format(path);
  if (format != MeshFormat::plot3d && !options.solution.empty()) {
    throw Error(fmt::format("a solution beside a mesh of format {}", to_string(format)),
                options.solution.string(),
                "only a PLOT3D grid has its values in a file of their own");
  }
  const MappedFile file(path);
  const NamedBytes mesh = named(file, path);
  switch (format) {
    case MeshFormat::vtu:
      return parse_vtu(mesh.bytes, mesh.name);
    case MeshFormat::vtk:
      return parse_vtk(mesh.bytes, mesh.name);
    case MeshFormat::msh:
      return parse_msh(mesh.bytes, mesh.name);
    case MeshFormat::plot3d:
      break;
  }
  if (options.solution.empty()) {
    return parse_plot3d(mesh, std::nullopt);
  }
  const MappedFile solution(options.solution);
  return parse_plot3d(mesh, named(solution, options.solution));
}

}  // namespace haarlight::render
