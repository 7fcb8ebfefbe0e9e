// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "haarlight/render/scene/scene.h"

/// @file
/// The readers behind read_obj, read_ply and read_scene, on text in memory: the entry points of the
/// fuzzers. Supported: OBJ `v vn vt f o g usemtl mtllib` (polygons as fans, so they should be
/// convex; negative indices; normals and texture coordinates only where every corner of a face has
/// one: a vertex of the mesh for each combination, in the order of the faces); in the .mtl `Kd Ks
/// Ns map_Kd`; PLY 1.0 ascii and binary_little_endian with vertex x y z [nx ny nz] [u v, s t or
/// texture_u texture_v] and face vertex_indices.

namespace haarlight::render {

/// @param name    used in errors as name:line
/// @param folder  folder of mtllib files; empty: they are not read
/// @throws Error  bad index, NaN, infinity, no triangles, a malformed number
[[nodiscard]] Scene parse_obj(std::string_view text, const std::string& name,
                              const std::filesystem::path& folder = {});

/// @throws Error  name:line in the header and in ascii bodies, name:offset in binary ones
[[nodiscard]] Scene parse_ply(std::string_view bytes, const std::string& name);

struct GltfOptions {
  bool has_materials =
      true;  ///< its own, cameras and lamps, too; else meshes alone, of material 0
  std::size_t max_triangles = kMaxTriangles;
};
/// A scene of glTF 2.0, as .gltf or .glb: docs/reference/gltf.md. Warns in the log of what it shows
/// otherwise than the file has it.
/// @param name    used in errors as "name: meshes[2].primitives[0]"
/// @param folder  of the files that it names; empty: they are not read
/// @throws Error  no glTF 2.0, an extension that is required and not read, bytes that are not
///                there, a number out of range, no triangles
[[nodiscard]] SceneFile parse_gltf(std::string_view bytes, const std::string& name,
                                   const std::filesystem::path& folder = {},
                                   const GltfOptions& options = {});
[[nodiscard]] SceneFile read_gltf(const std::filesystem::path& path,
                                  const GltfOptions& options = {});
/// By the ending of its name.
[[nodiscard]] bool is_gltf(const std::filesystem::path& path);

/// Decodes a material name of the form kd0.6_ks0.3_n60[_smooth].
/// @return  whether the name has that form
[[nodiscard]] bool decode_material_name(std::string_view name, Material& material);

}  // namespace haarlight::render
