// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include <Eigen/Geometry>

#include "haarlight/render/scene/scene.h"
#include "render/scene/gltf_document.h"
#include "render/scene/gltf_material.h"
#include "render/scene/gltf_warnings.h"

/// @file
/// Triangles of a glTF mesh, in its own frame.

namespace haarlight::render {

/// What a primitive becomes: nothing, where it has points or lines alone.
/// @param material  of it; nullptr: its own material is not asked for, nor are texture coordinates
///                  that only it would need
/// @throws Error  at the value that is none of a mesh
[[nodiscard]] Mesh read_gltf_primitive(GltfDocument& document, const JsonValue& primitive,
                                       const GltfMaterial* material, GltfWarnings& warnings);

/// The mesh where it stands. Its front stays its front, also where it is mirrored; triangles that
/// have no area there are left out.
/// @return  the number of those
std::size_t place_mesh(Mesh& mesh, const Eigen::Affine3d& to);

/// Whether each side of a triangle is another one's, the other way round.
[[nodiscard]] bool is_closed(const Mesh& mesh);

/// The same triangles seen from behind, moved back by 1e-5 of the mesh's size: of a surface that emits to both
/// sides, the other one.
[[nodiscard]] Mesh back_of(const Mesh& mesh);

}  // namespace haarlight::render
