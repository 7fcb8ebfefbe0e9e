// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "haarlight/core/image.h"
#include "haarlight/core/rig/camera_model.h"
#include "relight/hull/shadow_hull.h"

/// @file
/// How far from a camera the surface is that each of its pixels sees: somewhere in the hull's
/// voxels that are not known to be empty.

namespace haarlight::relight {

/// (height, width) mm from the camera's centre along the pixel's ray; 0: its ray meets no such
/// voxel.
struct DepthRange {
  Image<float> nearest;   ///< the first voxel begins no nearer
  Image<float> furthest;  ///< the last one ends no further
};

struct CameraDepths {
  DepthRange possible;  ///< voxels that are not empty
  DepthRange likely;    ///< the first run of those that are taken as matter
  std::int64_t n_wanted = 0;
  std::int64_t n_met = 0;  ///< of those, rays that meet the hull
  /// Rays of pixels well beside those wanted (three or more away) that meet what is taken as
  /// matter.
  std::int64_t n_elsewhere = 0;
};

/// @param wanted  (height, width) of the camera's picture, 0: not looked at
[[nodiscard]] CameraDepths camera_depths(const ShadowHull& hull, const CameraModel& camera,
                                         ImageView<const std::uint8_t> wanted);

}  // namespace haarlight::relight
