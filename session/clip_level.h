// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/core/rig/rig.h"

/// @file
/// The sample value from which a camera's picture is clipped. Pure.

namespace haarlight::session {

/// The white level, or 0.97 of the full well above black where the well comes first: a full
/// well is known to within 3 %. A well that reaches white within one step counts as white
/// itself (commissioning writes it so where the converter limits first), and so does a noise
/// model without a full well.
///
/// @param black, white  of the samples, DN
/// @return              DN, in (black, white]
[[nodiscard]] double clip_level(const SensorNoise& noise, double black, double white);

/// For a camera as described in its rig file, white at 2^bits - 1.
[[nodiscard]] double clip_level(const CameraSpec& camera);

}  // namespace haarlight::session
