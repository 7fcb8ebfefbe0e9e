// SPDX-License-Identifier: Apache-2.0
#include "render/surface/photon_shooting.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <optional>
#include <span>
#include <type_traits>
#include <utility>
#include <variant>

#include <fmt/format.h>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/bsdf/bsdf.h"
#include "render/bsdf/shading_frame.h"
#include "render/light/emitted_ray.h"
#include "render/sampling/sampler.h"
#include "render/surface/specular_direction.h"

namespace haarlight::render {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

constexpr std::uint64_t kPhotonKey = 0x70686f746f6eU;  // other numbers than any pixel's
constexpr std::size_t kTogether = 1024;                // rays that fill packets

// Dimensions of a ray: where it leaves the lights, then those of each bounce.
enum Dimension : std::uint32_t { position, direction, first_bounce };
enum BounceDimension : std::uint32_t { lobe, onward, roulette, per_bounce };
constexpr std::uint32_t dimension_of(int bounce, BounceDimension which) {
  return first_bounce + per_bounce * static_cast<std::uint32_t>(bounce) + which;
}

/// Of a photon: in the pass's own vectors, in the maps' and their trees, and of a final gather.
constexpr std::uint64_t kBytesOfPhoton = 180;

struct Flight {
  std::uint32_t number;     ///< of the ray that was shot
  Vector3d flux;            ///< RGB, in the unit of PhotonLight
  bool is_specular = true;  ///< all bounces so far were ideal
};

class Shooting {
 public:
  Shooting(const Scene& scene, const RayCaster& caster, const SceneLights& lights,
           const PhotonOptions& options)
      : scene_(&scene),
        caster_(&caster),
        lights_(&lights),
        options_(options),
        numbers_(options.sampler, hash_key(options.seed, kPhotonKey), 0, 0) {
    for (std::size_t i = 0; i < lights.size(); ++i) {
      power_ += power(lights[i]);
      const std::optional<std::uint32_t> surface = lights.surface_of(i);
      light_offsets_.push_back(surface ? caster.most_offset_mm(*surface) : 0.0);
    }
  }

  [[nodiscard]] double power_of_lights() const { return power_; }

  /// Rays first <= i < last.
  void shoot(std::uint32_t first, std::uint32_t last, ShotPhotons& shot) const {
    std::vector<Flight> flights;
    std::vector<Ray> rays;
    for (std::uint32_t i = first; i < last; ++i) {
      const ChosenLight chosen = lights_->choose_emitter(numbers_.two(i, position));
      const EmittedRay emitted = emit((*lights_)[chosen.index], caster_->scene_middle(),
                                      chosen.square, numbers_.two(i, direction));
      const Vector3d flux = emitted.flux() / chosen.probability / power_;
      flights.push_back({.number = i, .flux = flux});
      rays.push_back({.origin = emitted.origin + light_offsets_[chosen.index] * emitted.normal,
                      .direction = emitted.direction});
    }
    std::vector<RawHit> raw;
    std::vector<Hit> hits;
    for (int bounce = 0; !flights.empty(); ++bounce) {
      raw.resize(rays.size());
      hits.resize(rays.size());
      caster_->intersect(rays, RayOrder::scattered, raw);
      caster_->surfaces_at(rays, raw, hits);
      shot.n_rays += rays.size();
      std::size_t n_left = 0;
      for (std::size_t i = 0; i < flights.size(); ++i) {
        Ray next;
        if (raw[i].is_hit() && arrive(bounce, rays[i], hits[i], flights[i], next, shot)) {
          flights[n_left] = flights[i];
          rays[n_left] = next;
          ++n_left;
        }
      }
      flights.resize(n_left);
      rays.resize(n_left);
    }
  }

 private:
  /// Leaves a photon. @return whether the light goes on: `next`
  bool arrive(int bounce, const Ray& ray, const Hit& hit, Flight& flight, Ray& next,
              ShotPhotons& shot) const {
    const Bsdf bsdf = bsdf_of(*scene_, hit);
    if (is_black(bsdf)) {
      return false;
    }
    const Matrix3d world_from_local = shading_frame(hit, ray.direction);
    const Vector3d to_light = -(world_from_local.transpose() * ray.direction);
    // Irradiance is by the cosine to the triangle's normal, reflection by that to the shading one.
    const double arriving = to_light.z() / -hit.flat_normal.dot(ray.direction);
    if (has_smooth_part(bsdf)) {
      const PhotonKind kind = bounce == 0          ? PhotonKind::direct
                              : flight.is_specular ? PhotonKind::caustic
                                                   : PhotonKind::indirect;
      PhotonArrivals& arrivals = shot.arrivals[static_cast<std::size_t>(kind)];
      arrivals.sites.push_back(
          photon_site(hit, caster_->scene_middle(), caster_->scene_radius_mm()));
      arrivals.light.push_back({.direction = ray.direction.cast<float>(),
                                .flux = (arriving * flight.flux).cast<float>()});
      flight.is_specular = false;
    }
    return bounce < options_.most_bounces &&
           go_on(bounce, bsdf, ray, hit, world_from_local, to_light, arriving, flight, next);
  }

  bool go_on(int bounce, const Bsdf& bsdf, const Ray& ray, const Hit& hit,
             const Matrix3d& world_from_local, const Vector3d& to_light, double arriving,
             Flight& flight, Ray& next) const {
    const double which = numbers_.one(flight.number, dimension_of(bounce, lobe));
    const Vector2d square = numbers_.two(flight.number, dimension_of(bounce, onward));
    BsdfSample drawn = sample(bsdf, to_light, which, square);
    Vector3d direction = world_from_local * drawn.to_light;
    double adjoint = 1.0;
    if (drawn.is_found && is_on_its_side(hit, drawn, direction)) {
      adjoint = arriving * std::abs(hit.flat_normal.dot(direction) / drawn.to_light.z());
    }  // else it is lost, or an ideal one is drawn again about the triangle's normal
    std::visit(
        [&]<class Kind>(const Kind& kind) {
          if constexpr (kIsSpecular<Kind>) {
            mend_specular(kind, ray, hit, to_light, which, square, drawn, direction);
          }
        },
        bsdf);
    if (!drawn.is_found || !is_on_its_side(hit, drawn, direction)) {
      return false;
    }
    // Refraction changes the radiance, but not the flux.
    const Vector3d flux =
        adjoint / drawn.radiance_scale * flight.flux.cwiseProduct(drawn.weight);
    const double survives = std::min(1.0, flux.maxCoeff() / flight.flux.maxCoeff());
    if (!(numbers_.one(flight.number, dimension_of(bounce, roulette)) < survives)) {
      return false;
    }
    flight.flux = flux / survives;
    const double side = drawn.is_transmission ? -hit.offset_mm : hit.offset_mm;
    next = {.origin = hit.point + side * hit.flat_normal, .direction = direction};
    return true;
  }

  const Scene* scene_;
  const RayCaster* caster_;
  const SceneLights* lights_;
  PhotonOptions options_;
  PixelSamples numbers_;
  std::vector<double> light_offsets_;
  double power_ = 0.0;
};

[[noreturn]] void throw_too_many(const PhotonOptions& options) {
  constexpr std::uint64_t kMega = 1'000'000;
  throw Error(
      fmt::format(
          "the photons that {} rays from the lights leave need more than the {} MB that "
          "are left",
          options.photons, options.most_bytes / kMega),
      "--photons", "give fewer --photons or more --memory", ExitCode::usage);
}

}  // namespace

PhotonSite photon_site(const Hit& hit, const Vector3d& middle, double radius_mm) {
  return {.position = ((hit.point - middle) / radius_mm).cast<float>(),
          .normal = hit.flat_normal.cast<float>(),
          .surface = static_cast<std::uint32_t>(hit.mesh)};
}

ShotPhotons shoot_photons(const Scene& scene, const RayCaster& caster,
                          const SceneLights& lights, const PhotonOptions& options) {
  const Shooting shooting(scene, caster, lights, options);
  const std::size_t n_chunks = (options.photons + kTogether - 1) / kTogether;
  std::vector<ShotPhotons> chunks(n_chunks);
  const std::uint64_t most = options.most_bytes / kBytesOfPhoton;
  std::atomic<std::uint64_t> n_left{0};
  parallel_for(n_chunks, 1, [&](std::size_t first, std::size_t last) {
    for (std::size_t i = first; i < last && n_left <= most; ++i) {
      const auto begin = static_cast<std::uint32_t>(i * kTogether);
      const std::uint32_t n =
          std::min(static_cast<std::uint32_t>(kTogether), options.photons - begin);
      shooting.shoot(begin, begin + n, chunks[i]);
      for (const PhotonArrivals& arrivals : chunks[i].arrivals) {
        n_left += arrivals.light.size();
      }
    }
  });
  if (n_left > most) {
    throw_too_many(options);
  }
  ShotPhotons all;
  all.flux_unit = shooting.power_of_lights() / options.photons;
  for (ShotPhotons& chunk : chunks) {
    all.n_rays += chunk.n_rays;
    for (std::size_t kind = 0; kind < kPhotonKinds; ++kind) {
      PhotonArrivals& to = all.arrivals[kind];
      PhotonArrivals& from = chunk.arrivals[kind];
      to.sites.insert(to.sites.end(), from.sites.begin(), from.sites.end());
      to.light.insert(to.light.end(), from.light.begin(), from.light.end());
      from = {};
    }
  }
  return all;
}

}  // namespace haarlight::render
