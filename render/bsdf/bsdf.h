// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "haarlight/render/scene/scene.h"

/// @file
/// How a surface scatters light, at one point. Directions are unit vectors away from the
/// surface in the shading frame: z is the normal, on the side that is looked at.
///
/// `to_eye` is where light goes, `to_light` where it comes from. f is in 1/sr and without the
/// cosine; densities are per steradian.

namespace haarlight::render {

/// Lambert plus normalised Blinn-Phong, as Material has them: f = kd/pi + ks (n + 8)/(8 pi)
/// (n.h)^n above the surface, 0 below. Reciprocal. May reflect more than it receives where kd + ks
/// is near 1, seen from above.
struct Bsdf {
  Eigen::Vector3d kd = Eigen::Vector3d::Zero();
  double ks = 0.0;
  double exponent = 1.0;
};

struct BsdfSample {
  Eigen::Vector3d to_light = Eigen::Vector3d::Zero();
  Eigen::Vector3d f = Eigen::Vector3d::Zero();
  double density = 0.0;  ///< 0: no direction was found, the path ends
};

[[nodiscard]] Bsdf bsdf_of(const Material& material);

[[nodiscard]] bool is_black(const Bsdf& bsdf);

[[nodiscard]] Eigen::Vector3d evaluate(const Bsdf& bsdf, const Eigen::Vector3d& to_eye,
                                       const Eigen::Vector3d& to_light);

/// The density with which `sample` finds `to_light`.
[[nodiscard]] double density(const Bsdf& bsdf, const Eigen::Vector3d& to_eye,
                             const Eigen::Vector3d& to_light);

/// @param lobe, square  in [0, 1)
[[nodiscard]] BsdfSample sample(const Bsdf& bsdf, const Eigen::Vector3d& to_eye, double lobe,
                                const Eigen::Vector2d& square);

}  // namespace haarlight::render
