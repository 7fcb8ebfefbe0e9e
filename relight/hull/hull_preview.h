// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/core/image.h"
#include "haarlight/core/progress.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/relight/shadow/plane_frame.h"
#include "haarlight/render/mesh/mesh_writer.h"
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

/// (360 n_frames, 480, 3) linear: views from all around, one below the other. The first is from
/// the front; each next one is seen 1/n_frames of a turn further to the right. The light turns
/// with the eye, as if the object stood on a turntable.
[[nodiscard]] Image<float> hull_turning(const ShadowHull& hull,
                                        const render::SurfaceMesh& surface,
                                        const PlaneFrame& frame, int n_frames,
                                        ProgressStyle progress = ProgressStyle::none);

}  // namespace haarlight::relight
