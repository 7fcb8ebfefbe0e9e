// SPDX-License-Identifier: Apache-2.0
#include "render/surface/whitted_integrator.h"

#include <utility>

#include "haarlight/core/error.h"

namespace haarlight::render {

using Eigen::Vector3d;

namespace {

enum Question : std::uint32_t { lobe, direction_to_go };

}  // namespace

WhittedIntegrator::WhittedIntegrator(const Scene& scene, const RayCaster& caster,
                                     const Environment* environment, Camera camera,
                                     const WhittedOptions& options)
    : RayIntegrator(scene, caster, environment, std::move(camera), options.ray),
      most_bounces_(options.most_bounces) {
  HAARLIGHT_EXPECTS(options.most_bounces >= 0, "bounces are counted from 0");
}

Vector3d WhittedIntegrator::radiance(const Ray& first, const SampleNumbers& numbers,
                                     std::uint64_t& n_rays) const {
  Ray ray = first;
  Vector3d throughput = Vector3d::Ones();
  Vector3d sum = Vector3d::Zero();
  for (int bounce = 0;; ++bounce) {
    const RawHit raw = caster().intersect(ray);
    ++n_rays;
    if (!raw.is_hit()) {
      return sum + throughput.cwiseProduct(emitted_from_afar(ray));
    }
    const SurfacePoint at = surface_at(ray, raw);
    sum += throughput.cwiseProduct(emitted(at.hit));
    if (has_smooth_part(at.bsdf)) {
      return sum + throughput.cwiseProduct(direct_light(at, numbers, bounce, n_rays));
    }
    if (bounce == most_bounces_) {
      return sum;
    }
    if (!follow_specular(at, numbers.one(bounce, lobe), numbers.two(bounce, direction_to_go),
                         ray, throughput)) {
      return sum;
    }
  }
}

}  // namespace haarlight::render
