// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Geometry>

#include "core/json_value.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// Cameras of glTF.

namespace haarlight::render {

inline constexpr int kGltfLongerSide = 640;  ///< of a picture, pixels: glTF has none

/// @param to_world  of its node, to millimetres in our frame
/// @throws Error  at the value that is no camera's
void set_gltf_camera(const JsonValue& json, const Eigen::Affine3d& to_world, SceneFile& file);

}  // namespace haarlight::render
