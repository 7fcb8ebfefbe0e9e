// SPDX-License-Identifier: Apache-2.0
#include "render/surface/photon_maps.h"

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <utility>
#include <variant>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/surface/photon_shooting.h"

namespace haarlight::render {

using Eigen::Vector3d;
using Eigen::Vector3f;

namespace {

constexpr std::size_t kKnownEvery = 4;
constexpr double kOfThose = 4.0 / 3.0;  // all photons over those that are no such points
constexpr std::size_t kLookups = 256;   // that a thread does in turn

/// Whether the irradiance is computed at the photon: its position alone tells, so that one photon
/// more changes nothing elsewhere.
bool is_known(const PhotonSite& site) {
  const auto bits = [&](int axis) {
    return std::uint64_t{std::bit_cast<std::uint32_t>(site.position[axis])};
  };
  return hash_key(bits(0), bits(1), bits(2)) % kKnownEvery == 0;
}

}  // namespace

PhotonMaps::PhotonMaps(const Scene& scene, const RayCaster& caster, const SceneLights& lights,
                       const PhotonOptions& options)
    : options_(options), middle_(caster.scene_middle()), radius_mm_(caster.scene_radius_mm()) {
  HAARLIGHT_EXPECTS(options.nearest >= 2, "the k-th photon sets the radius for the others");
  HAARLIGHT_EXPECTS(options.most_radius > 0.0 && options.most_bounces >= 0,
                    "a radius, bounces from 0 on");
  flux_.fill(Vector3d::Zero());
  if (options.photons == 0 || lights.size() == 0 || !(radius_mm_ > 0.0)) {
    return;  // nothing arrives
  }
  ShotPhotons shot = shoot_photons(scene, caster, lights, options);
  n_rays_ = shot.n_rays;
  unit_ = shot.flux_unit / (radius_mm_ * radius_mm_);
  const auto fill = [](PhotonArrivals arrivals, Map& map) {
    if (arrivals.light.empty()) {
      return;
    }
    map.sites.emplace(std::move(arrivals.sites));
    map.light.reserve(arrivals.light.size());
    for (const std::uint32_t i : map.sites->order()) {
      map.light.push_back(arrivals.light[i]);
    }
  };
  PhotonArrivals all;
  std::vector<PhotonSite> known;
  for (std::size_t kind = 0; kind < kPhotonKinds; ++kind) {
    PhotonArrivals& arrivals = shot.arrivals[kind];
    sizes_[kind] = arrivals.light.size();
    for (const PhotonLight& light : arrivals.light) {
      flux_[kind] += shot.flux_unit * light.flux.cast<double>();
    }
    for (std::size_t i = 0; options.has_irradiance && i < arrivals.sites.size(); ++i) {
      if (is_known(arrivals.sites[i])) {
        known.push_back(arrivals.sites[i]);
      } else {
        all.sites.push_back(arrivals.sites[i]);
        all.light.push_back(arrivals.light[i]);
      }
    }
    if (!options.has_irradiance || kind == static_cast<std::size_t>(PhotonKind::caustic)) {
      fill(std::move(arrivals), maps_[kind]);
    }
    arrivals = {};
  }
  fill(std::move(all), all_);
  if (all_.sites && !known.empty()) {
    find_irradiance(std::move(known));
  }
}

/// At every fourth photon, so that it is known most densely where there is most light, by the others
/// alone: the nearest of points at which there are few photons is the nearest of a larger part of the
/// surface, so that its own photons, counted, would make the light 1/k too dim.
void PhotonMaps::find_irradiance(std::vector<PhotonSite> sites) {
  known_sites_.emplace(std::move(sites));
  known_.resize(known_sites_->size());
  // In the tree's order, in which the next one's photons are about the last one's.
  parallel_for(known_.size(), kLookups, [&](std::size_t first, std::size_t last) {
    NearPhotons found;
    std::vector<double> weights;
    for (std::size_t i = first; i < last; ++i) {
      all_.sites->nearest((*known_sites_)[i], static_cast<std::size_t>(options_.nearest),
                          options_.most_radius, found);
      weigh(options_.kernel, found, weights);
      Vector3d sum = Vector3d::Zero();
      for (std::size_t j = 0; j < weights.size(); ++j) {
        sum += weights[j] * all_.light[found.photons[j].index].flux.cast<double>();
      }
      known_[i] = (kOfThose * sum).cast<float>();
    }
  });
}

PhotonSite PhotonMaps::site_of(const Hit& hit) const {
  return photon_site(hit, middle_, radius_mm_);
}

Vector3d PhotonMaps::radiance(const Map& map, const PhotonQuery& query) const {
  if (!map.sites) {
    return Vector3d::Zero();
  }
  NearPhotons found;
  std::vector<double> weights;
  map.sites->nearest(site_of(query.hit), static_cast<std::size_t>(options_.nearest),
                     options_.most_radius, found);
  weigh(options_.kernel, found, weights);
  Vector3d sum = Vector3d::Zero();
  if (const auto* lambert = std::get_if<Lambert>(&query.bsdf)) {
    for (std::size_t i = 0; i < weights.size(); ++i) {
      sum += weights[i] * map.light[found.photons[i].index].flux.cast<double>();
    }
    return unit_ * std::numbers::inv_pi * lambert->kd.cwiseProduct(sum);
  }
  for (std::size_t i = 0; i < weights.size(); ++i) {
    const PhotonLight& photon = map.light[found.photons[i].index];
    const Vector3d to_light =
        -(query.world_from_local.transpose() * photon.direction.cast<double>());
    sum +=
        weights[i] *
        evaluate(query.bsdf, query.to_eye, to_light).cwiseProduct(photon.flux.cast<double>());
  }
  return unit_ * sum;
}

Vector3d PhotonMaps::radiance(PhotonKind kind, const PhotonQuery& query) const {
  HAARLIGHT_EXPECTS(!options_.has_irradiance || kind == PhotonKind::caustic,
                    "a map that is kept apart");
  return radiance(maps_[static_cast<std::size_t>(kind)], query);
}

Vector3d PhotonMaps::radiance(const PhotonQuery& query) const {
  HAARLIGHT_EXPECTS(options_.has_irradiance, "irradiance that was asked for");
  const auto* lambert = std::get_if<Lambert>(&query.bsdf);
  if (lambert == nullptr) {
    return kOfThose * radiance(all_, query);
  }
  if (!known_sites_) {
    return Vector3d::Zero();
  }
  const std::optional<std::uint32_t> nearest =
      known_sites_->nearest(site_of(query.hit), options_.most_radius);
  return nearest ? Vector3d(unit_ * std::numbers::inv_pi *
                            lambert->kd.cwiseProduct(known_[*nearest].cast<double>()))
                 : Vector3d::Zero();
}

}  // namespace haarlight::render
