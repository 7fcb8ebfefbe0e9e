// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include <Eigen/Geometry>

#include "haarlight/render/scene/scene.h"
#include "render/scene/gltf_document.h"
#include "render/scene/gltf_warnings.h"

/// @file
/// glTF's materials as ours: docs/reference/gltf.md.

namespace haarlight::render {

struct GltfMaterial {
  Material material;
  bool is_double_sided = false;
  bool has_base_texture = false;
  bool is_repeated = true;  ///< the base texture, as all are here
  std::string uv_attribute = "TEXCOORD_0";
  Eigen::Affine2d uv_transform = Eigen::Affine2d::Identity();
};

/// @param emission_scale  of its nits to radiance
/// @throws Error  at the value that is no material's
[[nodiscard]] GltfMaterial read_gltf_material(GltfDocument& document, const JsonValue& json,
                                              double emission_scale, GltfWarnings& warnings);

/// That of glTF for triangles without one.
[[nodiscard]] Material default_gltf_material();

/// A conductor of its base colour from half of metallic on; below, a coated surface or a matte one, with
/// the texture. Pictures that count by their mean are left to the caller.
void set_metallic_roughness(Material& material, const MetallicRoughness& of);

/// An index eta + i k of which a surface seen straight on reflects `f0`, and under light from everywhere
/// what Schlick's F0 + (1 - F0)(1 - cos)^5 reflects, (20 F0 + 1)/21, as far as any does
/// [Gulbrandsen14].
/// @param f0  RGB, 0 to 1; held to 1e-4 from either end
void set_index_of(Material& material, const Eigen::Vector3d& f0);

}  // namespace haarlight::render
