// SPDX-License-Identifier: Apache-2.0
#include "render/surface/photon_integrator.h"

#include <cstddef>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "haarlight/core/error.h"
#include "render/surface/light_ray.h"
#include "render/surface/power_heuristic.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

enum Question : std::uint32_t { light_point = SampleNumbers::first_own };

PhotonOptions photon_options(const PhotonMapOptions& options) {
  PhotonOptions photons = options.photons;
  photons.has_irradiance = options.has_final_gather;
  photons.most_bounces = options.most_bounces;
  photons.sampler = options.ray.sampler;
  photons.seed = options.ray.seed;
  return photons;
}

}  // namespace

PhotonMapIntegrator::PhotonMapIntegrator(const Scene& scene, const RayCaster& caster,
                                         const Environment* environment, Camera camera,
                                         const PhotonMapOptions& options)
    : RayIntegrator(scene, caster, environment, std::move(camera), options.ray),
      most_bounces_(options.most_bounces),
      has_final_gather_(options.has_final_gather),
      gather_rays_(options.gather_rays),
      maps_(scene, caster, lights(), photon_options(options)) {
  HAARLIGHT_EXPECTS(options.most_bounces >= 0, "bounces are counted from 0");
  HAARLIGHT_EXPECTS(gather_rays_ >= 1 && gather_rays_ <= kMostGatherRays,
                    "numbers of 2^20 samples");
}

PhotonQuery PhotonMapIntegrator::query_of(const SurfacePoint& at) {
  return {.hit = at.hit,
          .world_from_local = at.world_from_local,
          .to_eye = at.to_eye,
          .bsdf = at.bsdf};
}

/// Of a light that a gather ray has met, and that could have been asked instead.
double PhotonMapIntegrator::met_weight(const SurfacePoint& from, double density,
                                       std::size_t light, const LightHit& hit) const {
  const double asked = hit.distance_mm > nearest_asked(from.hit.offset_mm, light_offset(light))
                           ? lights().probability(light, {.point = from.hit.point,
                                                          .normal = from.hit.flat_normal}) *
                                 render::density(lights()[light], from.hit.point, hit)
                           : 0.0;
  return power_heuristic(gather_rays_ * density, asked);
}

Vector3d PhotonMapIntegrator::ask_lights(const SurfacePoint& at, const SampleNumbers& numbers,
                                         int bounce, std::uint64_t& n_rays) const {
  std::vector<Ray> rays;
  std::vector<Vector3d> arrives;
  const auto ask = [&](std::size_t i, double probability, const Vector2d& square) {
    const std::optional<AskedLight> found = ask_light(at, i, square);
    if (!found) {
      return;
    }
    const auto& [light, to_light, f, ray] = *found;
    const double asked = probability * light.density;
    const double weight =
        light.is_delta || !lights().is_met(i)
            ? 1.0
            : power_heuristic(asked, gather_rays_ * density(at.bsdf, at.to_eye, to_light));
    rays.push_back(ray);
    arrives.emplace_back(weight * to_light.z() / asked * f.cwiseProduct(light.radiance));
  };
  if (lights().size() == 0) {
    return Vector3d::Zero();
  }
  if (lights().choice() == LightChoice::all) {
    for (std::size_t i = 0; i < lights().size(); ++i) {
      ask(i, 1.0, numbers.light_point(bounce, i, lights().size()));
    }
  } else if (const std::optional<ChosenLight> chosen =
                 lights().choose({.point = at.hit.point, .normal = at.hit.flat_normal},
                                 numbers.two(bounce, light_point))) {
    ask(chosen->index, chosen->probability, chosen->square);
  }
  return sum_of_seen(rays, arrives, n_rays);
}

Vector3d PhotonMapIntegrator::gather(const SurfacePoint& at, const SampleNumbers& numbers,
                                     int bounce, std::uint64_t& n_rays) const {
  struct GatherRay {
    std::uint32_t number;
    double density;  ///< of its first direction
    Vector3d throughput;
  };
  std::vector<GatherRay> gathering;
  std::vector<Ray> rays;
  for (std::uint32_t i = 0; i < gather_rays_; ++i) {
    Ray ray;
    const std::optional<BsdfSample> next =
        go_on(at, numbers.one_of(bounce, SampleNumbers::lobe, i, gather_rays_),
              numbers.two_of(bounce, SampleNumbers::direction_to_go, i, gather_rays_), ray);
    if (next) {
      gathering.push_back({i, next->density, next->weight / gather_rays_});
      rays.push_back(ray);
    }
  }
  Vector3d sum = Vector3d::Zero();
  std::vector<RawHit> raw;
  for (int depth = 0; !rays.empty(); ++depth) {
    raw.resize(rays.size());
    caster().intersect(rays, RayOrder::scattered, raw);
    n_rays += rays.size();
    std::size_t n_left = 0;
    for (std::size_t i = 0; i < rays.size(); ++i) {
      const GatherRay one = gathering[i];
      Ray ray = rays[i];
      if (!raw[i].is_hit()) {
        const std::optional<std::size_t> light = lights().environment();
        if (light && depth == 0) {
          const LightHit met{.direction = ray.direction,
                             .distance_mm = std::numeric_limits<double>::infinity(),
                             .cosine = 1.0};
          sum += met_weight(at, one.density, *light, met) *
                 one.throughput.cwiseProduct(emitted_from_afar(ray));
        }
        continue;
      }
      const SurfacePoint there = surface_at(ray, raw[i]);
      const std::optional<std::size_t> light =
          lights().of_surface(static_cast<std::uint32_t>(there.hit.mesh));
      if (light && depth == 0 && there.hit.is_front) {
        const LightHit met{.direction = ray.direction,
                           .distance_mm = there.hit.distance_mm,
                           .cosine = -there.hit.flat_normal.dot(ray.direction)};
        sum += met_weight(at, one.density, *light, met) *
               one.throughput.cwiseProduct(emitted(there.hit));
      }  // beyond mirrors and glass it is of the caustics
      if (has_smooth_part(there.bsdf)) {
        sum += one.throughput.cwiseProduct(maps_.radiance(query_of(there)));
      } else if (const int after = bounce + 1 + depth; after < most_bounces_) {
        const std::optional<BsdfSample> next = go_on(
            there, numbers.one_of(after, SampleNumbers::lobe, one.number, gather_rays_),
            numbers.two_of(after, SampleNumbers::direction_to_go, one.number, gather_rays_),
            ray);
        if (next) {
          gathering[n_left] = one;
          gathering[n_left].throughput = one.throughput.cwiseProduct(next->weight);
          rays[n_left] = ray;
          ++n_left;
        }
      }
    }
    gathering.resize(n_left);
    rays.resize(n_left);
  }
  return sum;
}

Vector3d PhotonMapIntegrator::radiance(const Ray& first, const SampleNumbers& numbers,
                                       std::uint64_t& n_rays) const {
  const SpecularWay way = follow_specular(first, numbers, most_bounces_, n_rays);
  if (!way.end) {
    return way.sum;
  }
  const SurfacePoint& at = *way.end;
  const PhotonQuery query = query_of(at);
  Vector3d reflected = maps_.radiance(PhotonKind::caustic, query);
  if (has_final_gather_) {
    reflected +=
        ask_lights(at, numbers, way.bounces, n_rays) + gather(at, numbers, way.bounces, n_rays);
  } else {
    reflected +=
        maps_.radiance(PhotonKind::direct, query) + maps_.radiance(PhotonKind::indirect, query);
  }
  return way.sum + way.throughput.cwiseProduct(reflected);
}

}  // namespace haarlight::render
