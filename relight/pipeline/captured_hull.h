// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>

#include "relight/hull/shadow_hull.h"
#include "relight/pipeline/shadow_pipeline.h"

/// @file
/// The shadow hull of the captures of one object. Carving needs every light's shadow picture, so
/// that the result is kept next to the basis file and read again as long as nothing that it
/// came from has changed.

namespace haarlight::relight {

struct CapturedHull {
  ShadowHull hull;
  std::filesystem::path file;  ///< where it is kept; empty: it could not be written
  bool is_carved = true;       ///< now; false: read from `file`
  std::string why_not_kept;    ///< empty: it is kept
};

/// @param options  of the captures: basis, also, planes, plate, mask, object, hull_voxel_mm
/// @throws Error   as ShadowCaptures, build_hull
[[nodiscard]] CapturedHull captured_hull(const ShadowOptions& options);

}  // namespace haarlight::relight
