#pragma once

#include <vector>

#include "core/rig.h"
#include "render/scene.h"

/// @file
/// A rig's LEDs as the lights that render/ understands.

namespace haarlight {

/// The LED's square, radiance 1.
[[nodiscard]] SquareLight square_light(const LightElement& element);

/// Light k of the rig as element k.
[[nodiscard]] std::vector<SquareLight> rig_lights(const Rig& rig);

}  // namespace haarlight
