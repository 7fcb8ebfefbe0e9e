// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/mesh/mesh_writer.h"

#include <iterator>

#include <fmt/format.h>

#include "core/binary_writer.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"

namespace haarlight::render {

namespace {

void require_triangles(const SurfaceMesh& mesh, const std::filesystem::path& file) {
  if (mesh.triangles.empty()) {
    throw Error("the surface has no triangle", file.string(),
                "no four neighbouring pixels have a height: look at the mask and the errors");
  }
}

}  // namespace

void write_ply(const SurfaceMesh& mesh, const std::filesystem::path& file) {
  require_triangles(mesh, file);
  const bool has_uv = !mesh.uv.empty();
  BinaryWriter out(file);
  out.put_text(
      fmt::format("ply\nformat binary_little_endian 1.0\ncomment haarlight, mm\n"
                  "element vertex {}\n"
                  "property float x\nproperty float y\nproperty float z\n"
                  "property float nx\nproperty float ny\nproperty float nz\n"
                  "{}"
                  "property uchar red\nproperty uchar green\nproperty uchar blue\n"
                  "element face {}\nproperty list uchar int vertex_indices\n"
                  "end_header\n",
                  mesh.vertices.size(), has_uv ? "property float s\nproperty float t\n" : "",
                  mesh.triangles.size()));
  for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
    out.put(mesh.vertices[i]);
    out.put(mesh.normals[i]);
    if (has_uv) {
      out.put(mesh.uv[i]);
    }
    out.put(mesh.colours[i]);
  }
  for (const std::array<std::uint32_t, 3>& triangle : mesh.triangles) {
    out.put(std::uint8_t{3});
    out.put(triangle);
  }
  out.commit();
}

void write_obj(const SurfaceMesh& mesh, const std::filesystem::path& file,
               const std::string& texture) {
  require_triangles(mesh, file);
  std::filesystem::path materials = file;
  materials.replace_extension(".mtl");
  write_file_atomically(
      materials,
      fmt::format("newmtl surface\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nmap_Kd {}\n", texture));
  BinaryWriter out(file);
  out.put_text(
      fmt::format("# haarlight, mm\nmtllib {}\n", materials.filename().generic_string()));
  std::string text;
  for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
    const auto& [x, y, z] = mesh.vertices[i];
    const auto& [nx, ny, nz] = mesh.normals[i];
    const auto& [s, t] = mesh.uv[i];
    text.clear();
    fmt::format_to(std::back_inserter(text),
                   "v {:.7g} {:.7g} {:.7g}\nvt {:.7g} {:.7g}\nvn {:.5g} {:.5g} {:.5g}\n", x, y,
                   z, s, t, nx, ny, nz);
    out.put_text(text);
  }
  out.put_text("usemtl surface\n");
  for (const auto& [a, b, c] : mesh.triangles) {
    text.clear();
    fmt::format_to(std::back_inserter(text), "f {0}/{0}/{0} {1}/{1}/{1} {2}/{2}/{2}\n", a + 1,
                   b + 1, c + 1);
    out.put_text(text);
  }
  out.commit();
}

}  // namespace haarlight::render
