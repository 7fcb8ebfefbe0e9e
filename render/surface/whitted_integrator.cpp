// SPDX-License-Identifier: Apache-2.0
#include "render/surface/whitted_integrator.h"

#include <utility>

#include "haarlight/core/error.h"

namespace haarlight::render {

using Eigen::Vector3d;

WhittedIntegrator::WhittedIntegrator(const Scene& scene, const RayCaster& caster,
                                     const Environment* environment, Camera camera,
                                     const WhittedOptions& options)
    : RayIntegrator(scene, caster, environment, std::move(camera), options.ray),
      most_bounces_(options.most_bounces) {
  HAARLIGHT_EXPECTS(options.most_bounces >= 0, "bounces are counted from 0");
}

Vector3d WhittedIntegrator::radiance(const Ray& first, const SampleNumbers& numbers,
                                     std::uint64_t& n_rays) const {
  const SpecularWay way = follow_specular(first, numbers, most_bounces_, n_rays);
  if (!way.end) {
    return way.sum;
  }
  return way.sum +
         way.throughput.cwiseProduct(direct_light(*way.end, numbers, way.bounces, n_rays));
}

}  // namespace haarlight::render
