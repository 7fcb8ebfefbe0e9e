// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>

#include "capture/camera/camera.h"
#include "core/rig/rig.h"

/// @file
/// A camera that must be the one whose delays and noise were measured: with another behind the
/// same address every stamp would be read wrongly, silently.

namespace haarlight {

/// Passes everything on; `start` answers refused, and stops the camera, when its identity is
/// not that of rig.measured. The camera itself where nothing was measured.
[[nodiscard]] std::unique_ptr<Camera> require_measured_identity(std::unique_ptr<Camera> camera,
                                                                const Rig& rig);

}  // namespace haarlight
