// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/render/mesh/mesh_writer.h"
#include "relight/hull/shadow_hull.h"

/// @file
/// The hull's surface as triangles: constrained surface nets [Gibson98]. Each corner of a voxel
/// that is taken as matter, next to one that is not, is a vertex. The vertices are smoothed
/// without shrinking [Taubin95, lambda | mu], but move no further than half a voxel along each
/// axis: every voxel's centre stays on its side of the surface.

namespace haarlight::relight {

struct HullSurfaceOptions {
  int n_smoothings = 12;  ///< 0: the voxels' own faces
};

/// Closed, outward normals, world frame, mm; grey where the hull is matter, orange where that is
/// assumed. Where voxels meet in an edge or a corner only, the surface touches itself. Empty
/// without any voxel that is taken as matter.
[[nodiscard]] render::SurfaceMesh hull_surface(const ShadowHull& hull,
                                               const HullSurfaceOptions& options = {});

}  // namespace haarlight::relight
