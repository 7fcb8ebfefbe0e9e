// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

/// @file
/// Writes a textured surface as PLY or OBJ; read_ply and read_obj (haarlight/render/scene.h) read it
/// back.

namespace haarlight::render {

/// Triangles with a normal and a colour at every vertex, and a texture position if there is a
/// picture of the surface.
struct SurfaceMesh {
  std::vector<std::array<float, 3>> vertices;  ///< mm
  std::vector<std::array<float, 3>> normals;   ///< (n_vertices)
  /// Texture coordinates, v up, 0..1; empty: none. An .obj needs them.
  std::vector<std::array<float, 2>> uv;
  std::vector<std::array<std::uint8_t, 3>> colours;  ///< sRGB
  std::vector<std::array<std::uint32_t, 3>> triangles;
};

/// Binary little-endian PLY: x y z nx ny nz, s t if there are any, red green blue.
/// @throws Error  no triangles, unwritable
void write_ply(const SurfaceMesh& mesh, const std::filesystem::path& file);

/// OBJ and, next to it, an .mtl of the same name that references `texture` (relative to it).
/// @throws Error  no triangles, unwritable
void write_obj(const SurfaceMesh& mesh, const std::filesystem::path& file,
               const std::string& texture);

}  // namespace haarlight::render
