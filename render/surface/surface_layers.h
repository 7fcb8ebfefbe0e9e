// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/film/film.h"

/// @file
/// What all surface integrators write: the picture, and features of the first surface that the
/// camera sees, in the mean over the pixel, 0 where it sees none.

namespace haarlight::render {

/// Layers of the film, by their numbers.
struct SurfaceLayer {
  static constexpr std::size_t kRadiance = 0;
  static constexpr std::size_t kAlbedo = 1;  ///< render::albedo() of its BSDF
  static constexpr std::size_t kNormal = 2;  ///< shading normal, world, turned to the camera
  static constexpr std::size_t kDepth = 3;   ///< mm along the axis, 0 for samples that see none
  static constexpr std::size_t kCoverage = 4;  ///< fraction of samples that see a surface
  /// Of a pilot, the last: what path tracing's samples would have for squares, and light that they
  /// never meet; both summed over RGB.
  static constexpr std::size_t path_tracing(bool has_features) {
    return has_features ? kCoverage + 1 : kRadiance + 1;
  }
};

/// In the order of SurfaceLayer; without features the first alone.
/// @param has_splats  whether samples add to other pixels' radiance, too
[[nodiscard]] std::vector<FilmLayer> surface_layers(bool has_features, bool has_splats = false,
                                                    bool tells_of_path_tracing = false);

/// Adds a sample's features.
/// @param hit     where its camera ray meets a surface
/// @param axis    of the camera, unit
/// @param weight  of the sample, by the pixel's filter
void add_features(const Scene& scene, const Ray& ray, const Hit& hit,
                  const Eigen::Vector3d& axis, double weight, int x, int y, FilmTile& tile);

}  // namespace haarlight::render
