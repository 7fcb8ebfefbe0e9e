// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include <Eigen/Core>

#include "render/surface/photon_maps.h"
#include "render/surface/ray_integrator.h"

/// @file
/// Photon mapping [Jensen96]. In light-path notation [Heckbert90]: E[S*](D|G)(D|G|S)*L and E[S*]L,
/// biased by the maps' blur (photon_maps.h). A camera's ray goes on at ideal mirrors and glass alone.
/// At the first other surface either the three maps are looked up; or, with a final gather,
///  - lights are asked, L(D|G);
///  - the map of caustics is looked up, LS+(D|G);
///  - rays drawn of the BSDF go to the surfaces that light it, where all maps are looked up. Those
///    that meet a light are weighed against the points of lights that are asked [Veach95].

namespace haarlight::render {

struct PhotonMapOptions {
  RayOptions ray;
  PhotonOptions photons;  ///< has_irradiance, sampler and seed are set by the others
  int most_bounces = 64;  ///< of a camera ray at ideal surfaces, and of the photons
  bool has_final_gather = false;
  std::uint32_t gather_rays = 4;  ///< of each sample, at most 1024
};

class PhotonMapIntegrator final : public RayIntegrator {
 public:
  /// Makes the maps, on all threads.
  /// @throws Error  as PhotonMaps
  PhotonMapIntegrator(const Scene& scene, const RayCaster& caster,
                      const Environment* environment, Camera camera,
                      const PhotonMapOptions& options);

  static constexpr std::uint32_t kMostGatherRays = 1024;

  [[nodiscard]] const PhotonMaps& maps() const noexcept { return maps_; }

 private:
  [[nodiscard]] Eigen::Vector3d radiance(const Ray& ray, const SampleNumbers& numbers,
                                         std::uint64_t& n_rays) const override;
  [[nodiscard]] Eigen::Vector3d ask_lights(const SurfacePoint& at, const SampleNumbers& numbers,
                                           int bounce, std::uint64_t& n_rays) const;
  [[nodiscard]] Eigen::Vector3d gather(const SurfacePoint& at, const SampleNumbers& numbers,
                                       int bounce, std::uint64_t& n_rays) const;
  /// Refers to the point.
  [[nodiscard]] static PhotonQuery query_of(const SurfacePoint& at);
  [[nodiscard]] double met_weight(const SurfacePoint& from, double density, std::size_t light,
                                  const LightHit& hit) const;

  int most_bounces_;
  bool has_final_gather_;
  std::uint32_t gather_rays_;
  PhotonMaps maps_;
};

}  // namespace haarlight::render
