// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "haarlight/core/rig/rig.h"

/// @file
/// A rig of configs/rigs whose camera has few pixels.

namespace haarlight::capture {

/// The same view in `width` x `height` pixels, and 8 rows of metadata below them.
inline Rig rig_with_camera(const std::string& name, int width, int height) {
  constexpr int kMetadataRows = 8;
  Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/" + name + ".toml");
  CameraSpec& camera = rig.cameras.front();
  const double shrink = static_cast<double>(width) / camera.frame_width;
  camera.frame_width = width;
  camera.frame_height = height + kMetadataRows;
  camera.active_rows = height;
  camera.model.width = width;
  camera.model.height = height;
  camera.model.fx *= shrink;
  camera.model.fy *= shrink;
  camera.model.cx *= shrink;
  camera.model.cy *= shrink;
  return rig;
}

}  // namespace haarlight::capture
