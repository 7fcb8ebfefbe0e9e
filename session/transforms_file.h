// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/rig/camera_model.h"
#include "haarlight/session/light_file.h"

/// @file
/// transforms.json: cameras as in NeRF's data sets [Mildenhall20], with each frame's point
/// light as added by relighting data sets (`pl_pos`, `pl_intensity`). Pure.
///
/// A frame's `transform_matrix` maps the camera's frame (x right, y up, z backward) to the
/// world's, which is also the frame of `pl_pos`. Pixel centres are at +0.5.

namespace haarlight {
class JsonValue;
}

namespace haarlight::session {

/// Lights in a list's frame: x right, y up, z out of the picture, relative to the world origin,
/// where such data sets have their object. All frames must come from one camera. `pl_intensity`
/// becomes the relative power.
/// @param coordinates  automatic: positions where "unit" is "mm", otherwise refused, as the
/// unit is unknown
/// @throws Error  naming the field: no frames, no pl_pos, no rotation, two cameras
[[nodiscard]] LightList parse_transforms(const JsonValue& root, LightCoordinates coordinates);

/// Lengths in mm from `origin_world`.
/// @param lights  positions in the world's frame; their powers are not written
/// @param names   one picture per light, relative to the file
[[nodiscard]] std::string format_transforms(const CameraModel& camera,
                                            const Eigen::Vector3d& origin_world,
                                            const std::vector<SessionLight>& lights,
                                            const std::vector<std::string>& names);

}  // namespace haarlight::session
