#pragma once

#include <vector>

#include "core/rig.h"
#include "render/scene.h"

/// @file
/// A rig's LEDs as the lights that render/ understands. Render knows no rig; this is the
/// bridge.

namespace haarlight {

/// Light k of the rig as element k, radiance 1.
[[nodiscard]] std::vector<SquareLight> rig_lights(const Rig& rig);

}  // namespace haarlight
