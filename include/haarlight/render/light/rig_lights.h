// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "haarlight/core/rig/rig.h"
#include "haarlight/render/light/square_light.h"

/// @file
/// A rig's LEDs as lights for render/.

namespace haarlight::render {

/// The LED's square, radiance 1.
[[nodiscard]] SquareLight square_light(const LightElement& element);

/// Light k of the rig as element k.
[[nodiscard]] std::vector<SquareLight> rig_lights(const Rig& rig);

/// Lights that reach no point of the plane's picture on the side seen by the first camera (that
/// of its normal if there is none): in or behind the plane, or facing away from all of it.
[[nodiscard]] std::vector<int> lights_off_plane(const Rig& rig, const ShadowPlane& plane);

/// @return  words for a warning where some lights do not reach a plane; empty: all do
/// @throws Error  a plane that no light reaches
[[nodiscard]] std::string require_lit_planes(const Rig& rig);

}  // namespace haarlight::render
