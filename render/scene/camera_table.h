// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <vector>

#include "core/config_table.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// The [camera] of scene files, and files of several.

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

inline constexpr std::size_t kMaxCameras = 9999;

/// A file of [[camera]], each as a scene file's, in its order.
/// @throws Error  with file:line and a hint: what a scene file's would be refused for, none, or more than
///                kMaxCameras
[[nodiscard]] std::vector<CameraTable> read_cameras(const std::filesystem::path& path);

}  // namespace haarlight::render
