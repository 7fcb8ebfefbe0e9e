// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/core/image.h"
#include "haarlight/core/progress.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/relight/shadow/plane_frame.h"
#include "haarlight/render/mesh_writer.h"
#include "relight/hull/shadow_hull.h"

/// @file
/// Pictures of a hull, to look at.

namespace haarlight::relight {

/// (720, 960, 3) linear, four views: the capture's camera, from the front (against the plane's
/// v), from the right (against its u), from above. The floor is the plane's picture.
/// @param surface  of the hull, with a triangle at least
[[nodiscard]] Image<float> hull_preview(const ShadowHull& hull,
                                        const render::SurfaceMesh& surface,
                                        const CameraModel& camera, const PlaneFrame& frame,
                                        ProgressStyle progress = ProgressStyle::none);

}  // namespace haarlight::relight
