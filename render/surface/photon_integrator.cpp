// SPDX-License-Identifier: Apache-2.0
#include "render/surface/photon_integrator.h"

#include <cstddef>
#include <limits>
#include <optional>
#include <utility>
#include <variant>
#include <vector>

#include "haarlight/core/error.h"
#include "render/surface/light_ray.h"
#include "render/surface/power_heuristic.h"
#include "render/surface/specular_direction.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

enum Question : std::uint32_t { lobe, direction_to_go, light_point };

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
    const LightSample light = render::sample(lights()[i], at.hit.point, square);
    if (!light.is_found ||
        !(light.distance_mm > nearest_asked(at.hit.offset_mm, light_offset(i))) ||
        !(at.hit.flat_normal.dot(light.direction) > 0.0)) {
      return;
    }
    const Vector3d to_light = at.world_from_local.transpose() * light.direction;
    const Vector3d f = evaluate(at.bsdf, at.to_eye, to_light);
    if (!(f.maxCoeff() > 0.0)) {
      return;
    }
    const double asked = probability * light.density;
    const double weight =
        light.is_delta || !lights().is_met(i)
            ? 1.0
            : power_heuristic(asked, gather_rays_ * density(at.bsdf, at.to_eye, to_light));
    rays.push_back(light_ray(at.hit, light, light_offset(i)));
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
  std::vector<std::uint8_t> blocked(rays.size());
  caster().are_blocked(rays, RayOrder::scattered, blocked);
  n_rays += rays.size();
  Vector3d sum = Vector3d::Zero();
  for (std::size_t i = 0; i < rays.size(); ++i) {
    if (blocked[i] == 0) {
      sum += arrives[i];
    }
  }
  return sum;
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
    const BsdfSample next =
        sample(at.bsdf, at.to_eye, numbers.one_of(bounce, lobe, i, gather_rays_),
               numbers.two_of(bounce, direction_to_go, i, gather_rays_));
    const Vector3d direction = at.world_from_local * next.to_light;
    if (next.is_found && is_on_its_side(at.hit, next, direction)) {
      gathering.push_back({i, next.density, next.weight / gather_rays_});
      rays.push_back({.origin = at.hit.point + at.hit.offset_mm * at.hit.flat_normal,
                      .direction = direction});
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
      GatherRay& one = gathering[i];
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
        sum += one.throughput.cwiseProduct(
            maps_.radiance({.hit = there.hit,
                            .world_from_local = there.world_from_local,
                            .to_eye = there.to_eye,
                            .bsdf = there.bsdf}));
      } else if (const int next = bounce + 1 + depth;
                 next < most_bounces_ &&
                 follow_specular(
                     there, numbers.one_of(next, lobe, one.number, gather_rays_),
                     numbers.two_of(next, direction_to_go, one.number, gather_rays_), ray,
                     one.throughput)) {
        gathering[n_left] = one;
        rays[n_left] = ray;
        ++n_left;
      }
    }
    gathering.resize(n_left);
    rays.resize(n_left);
  }
  return sum;
}

Vector3d PhotonMapIntegrator::radiance(const Ray& first, const SampleNumbers& numbers,
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
      const PhotonQuery query{.hit = at.hit,
                              .world_from_local = at.world_from_local,
                              .to_eye = at.to_eye,
                              .bsdf = at.bsdf};
      Vector3d reflected = maps_.radiance(PhotonKind::caustic, query);
      if (has_final_gather_) {
        reflected +=
            ask_lights(at, numbers, bounce, n_rays) + gather(at, numbers, bounce, n_rays);
      } else {
        reflected += maps_.radiance(PhotonKind::direct, query) +
                     maps_.radiance(PhotonKind::indirect, query);
      }
      return sum + throughput.cwiseProduct(reflected);
    }
    if (bounce == most_bounces_ ||
        !follow_specular(at, numbers.one(bounce, lobe), numbers.two(bounce, direction_to_go),
                         ray, throughput)) {
      return sum;
    }
  }
}

}  // namespace haarlight::render
