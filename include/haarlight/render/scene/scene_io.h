// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "haarlight/render/scene/scene.h"

/// @file
/// The mesh readers behind read_obj and read_ply, on text in memory: the entry points of the
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

/// Decodes a material name of the form kd0.6_ks0.3_n60[_smooth].
/// @return  whether the name has that form
[[nodiscard]] bool decode_material_name(std::string_view name, Material& material);

}  // namespace haarlight::render
