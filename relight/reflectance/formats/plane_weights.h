// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "relight/reflectance/formats/reflectance.h"

/// @file
/// How much each plane of a model says in its lit pictures: what a coder of planes must know to
/// spend its bytes where they are seen.

namespace haarlight {

/// (n_planes): root mean square, over lights and R, G, B, of what one step of a plane's bytes
/// moves a lit picture by, 0..1 of white. Lights: the model's own, or 64 over the hemisphere.
/// Of lrgb, where luminance and colour multiply each other, also over pixels (a sample).
[[nodiscard]] std::vector<double> plane_weights(const ReflectanceModel& model);

}  // namespace haarlight
