// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <optional>

#include "core/config_table.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// The [camera] of scene files.

namespace haarlight::render {

inline constexpr double kMaxLength = 1e9;  ///< of what a scene file says, mm
inline constexpr double kMaxPictureSide = 65536.0;

struct CameraTable {
  CameraModel camera;
  CameraOptics optics;
};

/// `size`: width and height; nothing: a problem.
[[nodiscard]] std::optional<std::array<int, 2>> picture_size_of(ConfigTable& table);

/// Nothing, or something harmless: problems, in the table.
[[nodiscard]] std::optional<CameraTable> read_camera_table(ConfigTable& table);

}  // namespace haarlight::render
