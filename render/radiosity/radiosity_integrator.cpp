// SPDX-License-Identifier: Apache-2.0
#include "render/radiosity/radiosity_integrator.h"

#include <numbers>
#include <utility>

namespace haarlight::render {

using Eigen::Vector3d;

RadiosityIntegrator::RadiosityIntegrator(const Scene& scene, const RayCaster& caster,
                                         const Environment* environment, Camera camera,
                                         const RayOptions& options, PatchLight light)
    : RayIntegrator(scene, caster, environment, std::move(camera), options),
      light_(std::move(light)) {}

Vector3d RadiosityIntegrator::radiance(const Ray& ray, const SampleNumbers& numbers,
                                       std::uint64_t& n_rays) const {
  const RawHit raw = caster().intersect(ray);
  ++n_rays;
  if (!raw.is_hit()) {
    return emitted_from_afar(ray);
  }
  const SurfacePoint at = surface_at(ray, raw);
  const Vector3d by_surfaces =
      diffuse_albedo(at.bsdf, at.to_eye).cwiseProduct(light_.irradiance(raw, at.hit.is_front)) *
      std::numbers::inv_pi;
  return emitted(at.hit) + direct_light(at, numbers, 0, n_rays) + by_surfaces;
}

}  // namespace haarlight::render
