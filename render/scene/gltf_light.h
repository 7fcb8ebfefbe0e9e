// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Geometry>

#include "core/json_value.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// Lamps of KHR_lights_punctual, in candela and lux.

namespace haarlight::render {

/// Lumen to a watt of light: glTF's photometric numbers over it are those of a scene whose radiance
/// is in W m^-2 sr^-1. It is the factor of the programs that write watts as candela and lux.
inline constexpr double kLumensPerWatt = 683.0;
inline constexpr double kMillimetres = 1000.0;  ///< in a metre, glTF's unit

/// @param to_world  of its node, to millimetres in our frame
/// @throws Error  at the value that is no lamp's
void add_gltf_light(const JsonValue& json, const Eigen::Affine3d& to_world, Scene& scene);

}  // namespace haarlight::render
