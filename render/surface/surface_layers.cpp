// SPDX-License-Identifier: Apache-2.0
#include "render/surface/surface_layers.h"

#include "render/bsdf/bsdf.h"
#include "render/bsdf/shading_frame.h"

namespace haarlight::render {

using Eigen::Vector3d;

std::vector<FilmLayer> surface_layers(bool has_features, bool has_splats,
                                      bool tells_of_path_tracing) {
  std::vector<FilmLayer> layers{
      {.name = "radiance", .channels = 3, .has_error = true, .has_splats = has_splats}};
  if (has_features) {
    layers.push_back({.name = "albedo", .channels = 3});
    layers.push_back({.name = "normal", .channels = 3});
    layers.push_back({.name = "depth", .channels = 1});
    layers.push_back({.name = "coverage", .channels = 1});
  }
  if (tells_of_path_tracing) {
    layers.push_back({.name = "path tracing", .channels = 2});
  }
  return layers;
}

void add_features(const Scene& scene, const Ray& ray, const Hit& hit, const Vector3d& axis,
                  double weight, int x, int y, FilmTile& tile) {
  const Vector3d to_eye = -(shading_frame(hit, ray.direction).transpose() * ray.direction);
  const Vector3d reflected = render::albedo(bsdf_of(scene, hit), to_eye);
  tile.add(x, y, SurfaceLayer::kAlbedo, (weight * reflected).eval());
  tile.add(x, y, SurfaceLayer::kNormal, (weight * hit.normal).eval());
  tile.add(x, y, SurfaceLayer::kDepth, weight * hit.distance_mm * ray.direction.dot(axis));
  tile.add(x, y, SurfaceLayer::kCoverage, weight);
}

}  // namespace haarlight::render
