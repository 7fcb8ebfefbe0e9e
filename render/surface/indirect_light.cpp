// SPDX-License-Identifier: Apache-2.0
#include "render/surface/indirect_light.h"

#include <cstddef>
#include <optional>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/bsdf/bsdf.h"
#include "render/bsdf/shading_frame.h"
#include "render/sampling/sampler.h"

namespace haarlight::render {

using Eigen::Vector3d;

namespace {

enum BounceDimension : std::uint32_t { lobe, direction_to_go };
constexpr std::uint32_t kPerBounce = 4;
constexpr std::uint64_t kSeed = 0x1d1;

Hit hit_of(const SurfacePoint& surface) {
  return {.point = surface.point,
          .normal = surface.normal,
          .flat_normal = surface.flat_normal,
          .material = surface.material,
          .offset_mm = surface.offset_mm};
}

}  // namespace

IndirectLight::IndirectLight(const Scene& scene, const RayCaster& caster,
                             const DirectLight& direct, const IndirectOptions& options)
    : scene_(&scene), caster_(&caster), direct_(&direct), options_(options) {
  HAARLIGHT_EXPECTS(options.bounces >= 0 && options.paths >= 2 && options.paths % 2 == 0,
                    "an even number of paths");
}

std::uint64_t IndirectLight::add(const SurfacePoint& surface, const Vector3d& colour,
                                 const Paths& paths, std::span<LightContribution> scratch,
                                 std::span<double> even, std::span<double> odd) const {
  HAARLIGHT_EXPECTS(paths.n >= 2 && paths.n % 2 == 0, "an even number of paths");
  const PixelSamples numbers(SamplerKind::sobol, kSeed, paths.x, paths.y);
  HAARLIGHT_EXPECTS(surface.offset_mm > 0.0, "a surface that a ray has met");
  std::uint64_t n_rays = 0;
  for (int path = paths.first; path < paths.first + paths.n; ++path) {
    const auto sample = static_cast<std::uint32_t>(path);
    // Neighbours of the sequence go to different halves.
    const std::span<double> half = path % 2 == 0 ? even : odd;
    Vector3d throughput = paths.weight / (0.5 * paths.n) * colour;
    Hit hit = hit_of(surface);
    Vector3d direction = -surface.to_eye;
    for (int bounce = 0; bounce < options_.bounces; ++bounce) {
      const Eigen::Matrix3d world_from_local = shading_frame(hit, direction);
      const Vector3d to_eye = -(world_from_local.transpose() * direction);
      const std::uint32_t dimension = kPerBounce * static_cast<std::uint32_t>(bounce);
      const BsdfSample next =
          render::sample(bsdf_of(*scene_, hit), to_eye, numbers.one(sample, dimension + lobe),
                         numbers.two(sample, dimension + direction_to_go));
      direction = world_from_local * next.to_light;
      if (!next.is_found || !(hit.flat_normal.dot(direction) > 0.0)) {
        break;
      }
      throughput = throughput.cwiseProduct(next.weight);
      const std::optional<Hit> met =
          caster_->intersect(hit.point + hit.offset_mm * hit.flat_normal, direction);
      ++n_rays;
      if (!met) {
        break;
      }
      hit = *met;
      const Material& material = scene_->materials[static_cast<std::size_t>(hit.material)];
      n_rays += direct_->evaluate({.point = hit.point,
                                   .normal = hit.normal,
                                   .flat_normal = hit.flat_normal,
                                   .to_eye = -direction,
                                   .material = hit.material},
                                  material,
                                  hash_key(hash_key(static_cast<std::uint64_t>(paths.y),
                                                    static_cast<std::uint64_t>(paths.x)),
                                           sample, static_cast<std::uint64_t>(bounce) + 1),
                                  scratch);
      const double kd = throughput.dot(material.kd);
      const double ks = throughput.sum() * material.ks;
      for (std::size_t k = 0; k < half.size(); ++k) {
        half[k] += kd * scratch[k].diffuse + ks * scratch[k].specular;
      }
    }
  }
  return n_rays;
}

}  // namespace haarlight::render
