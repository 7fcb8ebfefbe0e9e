// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/light/scene_lights.h"
#include "render/surface/photon_maps.h"
#include "render/surface/photon_tree.h"

/// @file
/// The pass that fills photon maps: light leaves the lights by their power, and is reflected and
/// refracted until it is absorbed.

namespace haarlight::render {

/// The photons of a map, by the number of the ray that was shot.
struct PhotonArrivals {
  std::vector<PhotonSite> sites;
  std::vector<PhotonLight> light;
};

struct ShotPhotons {
  std::array<PhotonArrivals, kPhotonKinds> arrivals;
  double flux_unit = 0.0;  ///< of PhotonLight::flux, U mm^2 sr
  std::uint64_t n_rays = 0;
};

/// At each surface that is not ideal a photon is left, and the light goes on with the probability of
/// what is reflected, by the largest colour: so photons of one colour carry alike.
/// Of an interpolated normal the BSDF is the adjoint [Veach97], sec. 5.3.
/// There must be lights, and a scene of a radius above 0.
/// @throws Error  more photons than `options.most_bytes` have room for
[[nodiscard]] ShotPhotons shoot_photons(const Scene& scene, const RayCaster& caster,
                                        const SceneLights& lights,
                                        const PhotonOptions& options);

/// @param middle, radius_mm  RayCaster::scene_middle(), scene_radius_mm()
[[nodiscard]] PhotonSite photon_site(const Hit& hit, const Eigen::Vector3d& middle,
                                     double radius_mm);

}  // namespace haarlight::render
