// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <type_traits>
#include <variant>

#include <Eigen/Core>

#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/bsdf/blinn_phong.h"
#include "render/bsdf/bsdf_sample.h"
#include "render/bsdf/coated.h"
#include "render/bsdf/conductor.h"
#include "render/bsdf/lambert.h"
#include "render/bsdf/oren_nayar.h"
#include "render/bsdf/specular.h"

/// @file
/// How a surface scatters light, at one point: one value of any kind. Directions are unit vectors
/// away from the surface in the shading frame: z is the normal, on the side that is looked at.
///
/// `to_eye` is where light goes, `to_light` where it comes from. f is in 1/sr and without the
/// cosine; densities are per steradian. All functions are pure.

namespace haarlight::render {

using Bsdf =
    std::variant<Lambert, BlinnPhong, OrenNayar, Mirror, Dielectric, Conductor, Coated>;

/// Kinds of delta lobes only.
template <class Kind>
inline constexpr bool kIsSpecular =
    std::is_same_v<Kind, Mirror> || std::is_same_v<Kind, Dielectric>;

/// Kinds whose sample() may look at `lobe`.
template <class Kind>
inline constexpr bool kHasLobes =
    std::is_same_v<Kind, BlinnPhong> || std::is_same_v<Kind, Dielectric> ||
    std::is_same_v<Kind, Coated>;

/// Kinds of which a part scatters nearly alike in all directions: near_diffuse_albedo(), and the rest,
/// glossy().
template <class Kind>
inline constexpr bool kHasNearDiffusePart =
    std::is_same_v<Kind, Lambert> || std::is_same_v<Kind, BlinnPhong> ||
    std::is_same_v<Kind, OrenNayar> || std::is_same_v<Kind, Coated>;

/// Of the material that was hit, at that point, its texture included. Of a dielectric: as seen
/// from the hit's side. BsdfKind::blinn_phong without a glossy part is Lambert.
/// @throws ContractViolation  a texture that has not been loaded
[[nodiscard]] Bsdf bsdf_of(const Scene& scene, const Hit& hit);

/// Whether its kind has delta lobes only, without making it.
[[nodiscard]] inline bool scatters_delta_only(const Scene& scene, const Hit& hit) {
  const BsdfKind kind = scene.materials[static_cast<std::size_t>(hit.material)].bsdf;
  return kind == BsdfKind::mirror || kind == BsdfKind::dielectric;
}

/// Whether it reflects nothing: the path ends.
[[nodiscard]] bool is_black(const Bsdf& bsdf);

/// Whether it has more than delta lobes. Without, evaluate() is 0 everywhere, and no light needs to
/// be sampled.
[[nodiscard]] bool has_smooth_part(const Bsdf& bsdf);

/// Without delta lobes. 0 unless both directions are above the surface.
[[nodiscard]] Eigen::Vector3d evaluate(const Bsdf& bsdf, const Eigen::Vector3d& to_eye,
                                       const Eigen::Vector3d& to_light);

/// The density with which `sample` finds `to_light`, without delta lobes.
[[nodiscard]] double density(const Bsdf& bsdf, const Eigen::Vector3d& to_eye,
                             const Eigen::Vector3d& to_light);

/// What the near-diffuse part reflects of even light; 0 where there is none.
[[nodiscard]] Eigen::Vector3d near_diffuse_albedo(const Bsdf& bsdf,
                                                  const Eigen::Vector3d& to_eye);

/// @param lobe, square  in [0, 1)
[[nodiscard]] BsdfSample sample(const Bsdf& bsdf, const Eigen::Vector3d& to_eye, double lobe,
                                const Eigen::Vector2d& square);

/// The fraction of the light that leaves again, for a feature channel: an estimate, each kind's
/// header says which. In 0..1. @param to_eye  above the surface
[[nodiscard]] Eigen::Vector3d albedo(const Bsdf& bsdf, const Eigen::Vector3d& to_eye);

}  // namespace haarlight::render
