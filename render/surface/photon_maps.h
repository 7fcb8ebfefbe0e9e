// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/bsdf/bsdf.h"
#include "render/light/scene_lights.h"
#include "render/sampling/sampler.h"
#include "render/surface/photon_tree.h"

/// @file
/// Photon maps [Jensen96], [Jensen01]: rays that the lights shoot, and where they arrive. One pass fills
/// three maps by the way of the light, in Heckbert's notation [Heckbert90]: L(D|G), LS+(D|G) and all
/// others that end at a surface which is not ideal.
///
/// What the maps tell is biased: light is spread over the disk of the k nearest photons. The bias
/// falls with the number of photons, not with that of camera rays.

namespace haarlight::render {

enum class PhotonKind : std::uint8_t {
  direct,    ///< L(D|G)
  caustic,   ///< LS+(D|G)
  indirect,  ///< L(D|G|S)*(D|G)(D|G|S)*(D|G)
};
inline constexpr std::size_t kPhotonKinds = 3;

struct PhotonOptions {
  std::uint32_t photons = 400'000;  ///< that the lights shoot
  int nearest = 50;                 ///< 2 or more: k
  PhotonKernel kernel = PhotonKernel::constant;
  double most_radius = 0.1;  ///< of the k nearest's disk, over the scene's radius
  int most_bounces = 64;     ///< light that has been reflected more often is left out
  /// Also the irradiance at every fourth photon [Christensen99]: for a final gather.
  bool has_irradiance = false;
  SamplerKind sampler = SamplerKind::sobol;
  std::uint64_t seed = 0;
  std::uint64_t most_bytes = std::numeric_limits<std::uint64_t>::max();
};

/// Light that has arrived at a surface.
struct PhotonLight {
  Eigen::Vector3f direction = Eigen::Vector3f::Zero();  ///< unit, in which it came
  /// RGB. Mean over the colours 1: the power of all lights over the number of photons that are shot.
  Eigen::Vector3f flux = Eigen::Vector3f::Zero();
};

/// Where a radiance or an irradiance is wanted.
struct PhotonQuery {
  const Hit& hit;
  const Eigen::Matrix3d& world_from_local;  ///< the BSDF's frame
  const Eigen::Vector3d& to_eye;            ///< local
  const Bsdf& bsdf;
};

class PhotonMaps {
 public:
  /// Shoots them, on all threads: the same maps for any number of them.
  /// @throws Error  more than `most_bytes`
  PhotonMaps(const Scene& scene, const RayCaster& caster, const SceneLights& lights,
             const PhotonOptions& options);

  /// Photons of a map.
  [[nodiscard]] std::size_t size(PhotonKind kind) const {
    return sizes_[static_cast<std::size_t>(kind)];
  }
  /// Flux of all of them, RGB, U mm^2 sr.
  [[nodiscard]] const Eigen::Vector3d& flux(PhotonKind kind) const {
    return flux_[static_cast<std::size_t>(kind)];
  }
  [[nodiscard]] std::uint64_t n_rays() const noexcept { return n_rays_; }

  /// What a surface sends to the eye of a map's light: the sum of f dPhi/dA. Where `has_irradiance` was
  /// asked for, of caustics alone: the others are not kept apart.
  [[nodiscard]] Eigen::Vector3d radiance(PhotonKind kind, const PhotonQuery& query) const;
  /// Of all maps: of a Lambertian surface by the irradiance at the nearest site where it is known.
  /// Where `has_irradiance` was asked for.
  [[nodiscard]] Eigen::Vector3d radiance(const PhotonQuery& query) const;

 private:
  struct Map {
    std::optional<SiteTree> sites;  ///< nothing: an empty map
    std::vector<PhotonLight> light;
  };
  [[nodiscard]] PhotonSite site_of(const Hit& hit) const;
  [[nodiscard]] Eigen::Vector3d radiance(const Map& map, const PhotonQuery& query) const;
  void find_irradiance(std::vector<PhotonSite> sites);

  PhotonOptions options_;
  Eigen::Vector3d middle_;
  double radius_mm_;
  double unit_ = 0.0;  ///< of flux per area, U sr
  std::array<Map, kPhotonKinds> maps_;
  Map all_;  ///< of all kinds, for a final gather
  // Irradiance at some of them, in `unit_`:
  std::optional<SiteTree> known_sites_;
  std::vector<Eigen::Vector3f> known_;
  std::array<std::size_t, kPhotonKinds> sizes_{};
  std::array<Eigen::Vector3d, kPhotonKinds> flux_;
  std::uint64_t n_rays_ = 0;
};

}  // namespace haarlight::render
