// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/bsdf/bsdf.h"
#include "render/radiosity/exchange.h"
#include "render/radiosity/patches.h"
#include "render/radiosity/vertex_light.h"

/// @file
/// Diffuse light between the surfaces of a scene, by radiosity [Goral84], before there is a picture:
/// what arrives at the vertices of its patches by way of other surfaces.

namespace haarlight::render {

struct RadiosityOptions {
  std::size_t patches = 10'000;  ///< each has two sides
  std::uint32_t rays = 1024;     ///< of each side for its form factors, and of each vertex
  std::uint64_t seed = 0;
};

/// Refuses what radiosity cannot have: mirrors, glass, metals and coats; exact spheres and disks that
/// reflect. What is glossy counts by its diffuse part between surfaces, kd.
/// @throws Error  names the material
void require_diffuse(const Scene& scene);

/// The diffuse part's albedo, for light that leaves that way. @param to_eye  local
[[nodiscard]] Eigen::Vector3d diffuse_albedo(const Bsdf& bsdf, const Eigen::Vector3d& to_eye);

/// Between the sides of all patches, by rays that see what is in the way.
[[nodiscard]] Exchange<float> form_factors(const Scene& scene, const RayCaster& caster,
                                           const Patches& patches,
                                           const RadiosityOptions& options);

class PatchLight {
 public:
  /// Solves for it, on all threads. The scene is diffuse (require_diffuse).
  /// @param environment  of the scene's source; nothing: the scene has none
  PatchLight(const Scene& scene, const RayCaster& caster, const Environment* environment,
             const RadiosityOptions& options);

  /// An estimate from above.
  [[nodiscard]] static std::uint64_t bytes_needed(const Scene& scene,
                                                  const RadiosityOptions& options);

  /// Irradiance by way of other surfaces, RGB, interpolated in the patch that a ray has met (VertexLight).
  /// 0 of what is not cut into patches.
  [[nodiscard]] Eigen::Vector3d irradiance(const RawHit& hit, bool is_front) const;

  [[nodiscard]] const Patches& patches() const noexcept { return patches_; }
  /// Of each element (Elements): what it reflects, RGB, irradiance that arrives times albedo.
  [[nodiscard]] const std::vector<Eigen::Vector3d>& radiosity() const noexcept {
    return radiosity_;
  }

 private:
  Patches patches_;
  std::vector<Eigen::Vector3d> radiosity_;  ///< (elements,)
  std::optional<VertexLight> shown_;
};

}  // namespace haarlight::render
