// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

/// @file
/// Fresnel's equations for unpolarised light, exact [Born99].

namespace haarlight::render {

/// Cosine of the refracted ray with its own normal, by Snell's law. 0 at total reflection.
/// @param cosine  of the ray that arrives, 0 to 1
/// @param ior     of the other side over that of this side
[[nodiscard]] double refracted_cosine(double cosine, double ior);

/// Reflectance of a boundary between dielectrics. Exactly 0 for ior = 1, exactly 1 at total
/// reflection. Parameters as above.
[[nodiscard]] double fresnel_dielectric(double cosine, double ior);

/// Reflectance of a conductor of index eta + i k, for each colour.
[[nodiscard]] Eigen::Vector3d fresnel_conductor(double cosine, const Eigen::Vector3d& eta,
                                                const Eigen::Vector3d& k);

}  // namespace haarlight::render
