// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "haarlight/core/rig/camera_model.h"

namespace haarlight {

/// Which area of the picture, in square pixels, a camera makes of a unit area of the plane at distance
/// 1 before it: |det| of the derivatives of project().
/// @param on_plane  a point of that plane, (x/z, y/z) in the camera's frame
[[nodiscard]] double picture_area(const CameraModel& camera, const Eigen::Vector2d& on_plane);

}  // namespace haarlight
