// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "core/image.h"

/// @file
/// A recovered surface as triangles, for programs that read PLY or OBJ: one vertex per known
/// pixel, two triangles per square of four. Nothing is extrapolated: triangles with an unknown
/// corner, across a cut, or steeper than allowed are left out, as are vertices that no triangle
/// uses.

namespace haarlight {

struct SurfaceMesh {
  std::vector<std::array<float, 3>> vertices;        ///< mm
  std::vector<std::array<float, 3>> normals;         ///< (n_vertices)
  std::vector<std::array<float, 2>> uv;              ///< texture coordinates, v up, 0..1
  std::vector<std::array<std::uint8_t, 3>> colours;  ///< sRGB
  std::vector<std::array<std::uint32_t, 3>> triangles;
};

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
[[nodiscard]] SurfaceMesh make_surface_mesh(ImageView<const float> points,
                                            ImageView<const std::uint8_t> is_known,
                                            ImageView<const std::uint8_t> is_cut,
                                            ImageView<const float> normals,
                                            ImageView<const float> albedo,
                                            const SurfaceMeshOptions& options = {});

/// Binary little-endian PLY: x y z nx ny nz s t red green blue.
/// @throws Error  no triangles, unwritable
void write_ply(const SurfaceMesh& mesh, const std::filesystem::path& file);

/// OBJ and, next to it, an .mtl of the same name that references `texture` (relative to it).
/// @throws Error  no triangles, unwritable
void write_obj(const SurfaceMesh& mesh, const std::filesystem::path& file,
               const std::string& texture);

}  // namespace haarlight
