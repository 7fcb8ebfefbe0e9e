// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "haarlight/relight/reflectance/formats/reflectance.h"

/// @file
/// How much each plane of a model affects its lit pictures: lets a coder of planes spend its
/// bytes where they are seen.

namespace haarlight::relight {

/// (n_planes): root mean square, over lights and R, G, B, of the change of a lit picture per
/// step of a plane's bytes, 0..1 of white. Lights: the model's own, or 64 over the hemisphere.
/// For lrgb, where luminance and colour are multiplied, also over pixels (a sample).
[[nodiscard]] std::vector<double> plane_weights(const ReflectanceModel& model);

}  // namespace haarlight::relight
