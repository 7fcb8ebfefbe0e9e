// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/render/scene/scene.h"

/// @file
/// Whether all light of a scene is direct.

namespace haarlight::render {

/// Whether light may go from a surface of the scene to another one, and from there on. False where
/// what reflects is a single flat mesh or disk that lets no light through, whatever emits: a
/// sufficient condition, of shapes and materials alone.
[[nodiscard]] bool has_indirect_light(const Scene& scene);

/// Whether every vertex that a triangle uses is within 1e-12 of the mesh's size of one plane.
[[nodiscard]] bool is_flat(const Mesh& mesh);

}  // namespace haarlight::render
