// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>

#include "capture/camera/camera.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// Insists on the camera whose delays and noise were measured: with a different one at the same
/// address every timestamp would silently be misread.

namespace haarlight::capture {

/// Forwards every call; `start` faults with refused, and stops the camera, when its identity is
/// not that of rig.measured. Returns the camera itself where nothing was measured.
[[nodiscard]] std::unique_ptr<Camera> require_measured_identity(std::unique_ptr<Camera> camera,
                                                                const Rig& rig);

}  // namespace haarlight::capture
