// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "render/volume/volume_scene.h"

/// @file
/// Which volume a picture is of: what a film that is kept is held to.

namespace haarlight::render {

/// Of all that a pixel depends on, as it was read: a file that changes afterwards changes nothing.
/// 32 hexadecimal digits each, as content_hash().
struct VolumeHashes {
  std::string mesh;    ///< points, cells and fields
  std::string looks;   ///< transfer functions, contours
  std::string behind;  ///< background, surfaces
  std::string camera;
};

[[nodiscard]] VolumeHashes hashes_of(const VolumeScene& scene);

}  // namespace haarlight::render
