// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include <Eigen/Core>

#include "haarlight/core/image.h"
#include "haarlight/render/mesh/mesh_writer.h"

/// @file
/// A recovered surface as triangles, for programs that read PLY or OBJ: one vertex per
/// known pixel, two triangles per square of four. Nothing is made up: triangles with an unknown
/// corner, across a cut, or steeper than requested are left out, and so are vertices that no
/// triangle uses.

namespace haarlight::relight {

struct SurfaceMeshOptions {
  /// Triangles whose normal is further from `towards` are left out, degrees.
  double max_tilt_deg = 89.0;
  Eigen::Vector3d towards = Eigen::Vector3d::UnitZ();  ///< unit, to the camera
};

/// Triangles are counter-clockwise seen from the camera.
/// @param points    (height, width, 3)
/// @param is_known  (height, width)
/// @param is_cut    (height, width, 2), 1: not joined to the right (0), down (1); may be empty
/// @param normals   (height, width, 3), in the points' frame
/// @param albedo    (height, width, 1 or 3) linear; 1 becomes white
[[nodiscard]] render::SurfaceMesh make_surface_mesh(ImageView<const float> points,
                                                    ImageView<const std::uint8_t> is_known,
                                                    ImageView<const std::uint8_t> is_cut,
                                                    ImageView<const float> normals,
                                                    ImageView<const float> albedo,
                                                    const SurfaceMeshOptions& options = {});

}  // namespace haarlight::relight
