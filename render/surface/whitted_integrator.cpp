// SPDX-License-Identifier: Apache-2.0
#include "render/surface/whitted_integrator.h"

#include <type_traits>
#include <utility>
#include <variant>

#include "haarlight/core/error.h"
#include "render/surface/specular_direction.h"

namespace haarlight::render {

using Eigen::Vector2d;
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
    // Of glass one of reflection and refraction, by Fresnel's equations: both would be two rays, and
    // theirs four.
    const double which = numbers.one(bounce, lobe);
    const Vector2d square = numbers.two(bounce, direction_to_go);
    BsdfSample next = sample(at.bsdf, at.to_eye, which, square);
    Vector3d direction = at.world_from_local * next.to_light;
    std::visit(
        [&](const auto& bsdf) {
          if constexpr (kIsSpecular<std::decay_t<decltype(bsdf)>>) {
            mend_specular(bsdf, ray, at.hit, at.to_eye, which, square, next, direction);
          }
        },
        at.bsdf);
    if (!next.is_found || !is_on_its_side(at.hit, next, direction)) {
      return sum;
    }
    throughput = throughput.cwiseProduct(next.weight);
    const double side = next.is_transmission ? -at.hit.offset_mm : at.hit.offset_mm;
    ray = {.origin = at.hit.point + side * at.hit.flat_normal, .direction = direction};
  }
}

}  // namespace haarlight::render
