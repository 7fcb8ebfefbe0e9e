// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "render/surface/ray_integrator.h"

/// @file
/// Ray casting and Whitted's ray tracing [Whitted80]. In light-path notation [Heckbert90]:
/// E[S*](D|G)L and E[S*]L. A camera's ray goes on at ideal mirrors and glass alone, up to
/// `most_bounces` times; at the first other surface all lights are asked, a point of each, and it
/// ends. With most_bounces = 0 that is ray casting, E[(D|G)]L.
///
/// Left out, whatever the number of samples: light that comes by way of a surface that is neither,
/// caustics, and what glossy surfaces reflect but for lights.

namespace haarlight::render {

struct WhittedOptions {
  RayOptions ray;
  int most_bounces = 64;
};

class WhittedIntegrator final : public RayIntegrator {
 public:
  WhittedIntegrator(const Scene& scene, const RayCaster& caster, const Environment* environment,
                    Camera camera, const WhittedOptions& options);

 private:
  [[nodiscard]] Eigen::Vector3d radiance(const Ray& ray, const SampleNumbers& numbers,
                                         std::uint64_t& n_rays) const override;

  int most_bounces_;
};

}  // namespace haarlight::render
