// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "render/bsdf/bsdf_sample.h"

/// @file
/// A rough diffuse surface: Lambertian facets whose slope angles have the standard deviation sigma
/// [Oren94], in the energy-preserving form [Portsmouth25].
///
/// Why not the qualitative model of 1994: with an albedo of 1 it reflects up to 101.5 % at grazing
/// angles (sigma = 11 degrees) and down to 78 % (90 degrees). The form used here reflects 100 % at
/// all angles for all sigma, in closed form, and is reciprocal, too.

namespace haarlight::render {

struct OrenNayar {
  Eigen::Vector3d kd = Eigen::Vector3d::Zero();  ///< albedo of a facet
  /// Strength of the backscattering, 0 (Lambert) to 1.
  double roughness = 0.0;

  /// @param sigma  radians, 0 to pi/2. Its strength is B/A of the qualitative model of [Oren94], so
  ///               that the ratio of the two terms is the one of that paper.
  [[nodiscard]] static OrenNayar of(const Eigen::Vector3d& kd, double sigma);

  [[nodiscard]] bool is_black() const { return kd.isZero(0.0); }
  [[nodiscard]] Eigen::Vector3d evaluate(const Eigen::Vector3d& to_eye,
                                         const Eigen::Vector3d& to_light) const;
  /// cos/pi
  [[nodiscard]] double density(const Eigen::Vector3d& to_eye,
                               const Eigen::Vector3d& to_light) const;
  [[nodiscard]] BsdfSample sample(const Eigen::Vector3d& to_eye, double lobe,
                                  const Eigen::Vector2d& square) const;
  [[nodiscard]] Eigen::Vector3d near_diffuse_albedo(const Eigen::Vector3d& to_eye) const {
    return albedo(to_eye);
  }
  [[nodiscard]] static Eigen::Vector3d glossy(const Eigen::Vector3d& /*to_eye*/,
                                              const Eigen::Vector3d& /*to_light*/) {
    return Eigen::Vector3d::Zero();
  }
  /// Directional-hemispherical reflectance, exact. It is 1 for kd = 1.
  [[nodiscard]] Eigen::Vector3d albedo(const Eigen::Vector3d& to_eye) const;
};

}  // namespace haarlight::render
