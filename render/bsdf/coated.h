// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "render/bsdf/bsdf_sample.h"
#include "render/bsdf/ggx.h"

/// @file
/// A Lambertian base under a rough, clear dielectric coat.
///
///     f = F D G / (4 cos_o cos_i) + rho/pi T(o) T(i) / ((1 - rho) n^2 + rho <T>)
///
/// T is what the coat lets through, one less its albedo, and <T> its mean weighted by cos/pi. The
/// denominator is n^2 (1 - rho R), where R = 1 - <T>/n^2 is what the coat returns of the base's
/// diffuse light: the sum over any number of reflections between the two [Saunderson42]. With
/// rho = 1 nothing is lost: both parts together reflect 1, less what CoatAlbedo errs.
/// Reciprocal. What the coat's facets lose by scattering once only goes on to the base.

namespace haarlight::render {

/// The rho of which a coat lets <T> seen be seen under light from everywhere: rho <T>^2 over the
/// denominator above, solved. 0 and 1 stay what they are.
/// @param seen  RGB, 0 to 1
[[nodiscard]] Eigen::Vector3d kd_under_coat(const Eigen::Vector3d& seen, double ior,
                                            double alpha);

struct Coated {
  Eigen::Vector3d kd = Eigen::Vector3d::Zero();  ///< rho, of the base in the coat's medium
  double ior = 1.5;                              ///< n: 1.2 to 2.5
  Ggx facets;

  [[nodiscard]] static bool is_black() { return false; }
  [[nodiscard]] Eigen::Vector3d evaluate(const Eigen::Vector3d& to_eye,
                                         const Eigen::Vector3d& to_light) const;
  [[nodiscard]] double density(const Eigen::Vector3d& to_eye,
                               const Eigen::Vector3d& to_light) const;
  [[nodiscard]] BsdfSample sample(const Eigen::Vector3d& to_eye, double lobe,
                                  const Eigen::Vector2d& square) const;
  /// Of the base, seen through the coat.
  [[nodiscard]] Eigen::Vector3d near_diffuse_albedo(const Eigen::Vector3d& to_eye) const {
    return base_albedo(to_eye.z());
  }
  /// Of the coat.
  [[nodiscard]] Eigen::Vector3d glossy(const Eigen::Vector3d& to_eye,
                                       const Eigen::Vector3d& to_light) const;
  /// Directional-hemispherical reflectance, to the accuracy of CoatAlbedo.
  [[nodiscard]] Eigen::Vector3d albedo(const Eigen::Vector3d& to_eye) const;

 private:
  /// f of the base over T(o) T(i).
  [[nodiscard]] Eigen::Vector3d base() const;
  /// Reflectance of the base, seen through the coat.
  [[nodiscard]] Eigen::Vector3d base_albedo(double cosine) const;
  [[nodiscard]] double reflectance(double cosine) const;
  /// Probability with which the coat is sampled: by what the two parts reflect.
  [[nodiscard]] double coat_fraction(double cosine) const;
};

}  // namespace haarlight::render
