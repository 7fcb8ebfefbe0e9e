// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "render/radiosity/patch_light.h"
#include "render/surface/ray_integrator.h"

/// @file
/// Radiosity [Goral84]: ED*L in light-path notation [Heckbert90]. Light between diffuse surfaces is
/// solved for once, on patches (PatchLight), and shown by interpolation between their vertices. What
/// arrives from lights directly is not interpolated: all lights are asked at the point that is
/// shown, a point of each.
///
/// Biased: by the patches' size, whatever the number of samples; light by way of gloss is left out,
/// but for that of lights themselves.

namespace haarlight::render {

class RadiosityIntegrator final : public RayIntegrator {
 public:
  /// Keeps references to all but the camera.
  /// @param light  of that scene
  RadiosityIntegrator(const Scene& scene, const RayCaster& caster,
                      const Environment* environment, Camera camera, const RayOptions& options,
                      PatchLight light);

 private:
  [[nodiscard]] Eigen::Vector3d radiance(const Ray& ray, const SampleNumbers& numbers,
                                         std::uint64_t& n_rays) const override;

  PatchLight light_;
};

}  // namespace haarlight::render
