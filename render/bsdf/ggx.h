// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

/// @file
/// The GGX distribution of microfacet normals [Walter07] with Smith's height-correlated
/// masking-shadowing [Heitz14], isotropic, and reflection from it:
///
///     f = F(h.o) D(h) G(o, i) / (4 cos_o cos_i)
///
/// One scattering only: what a facet sends on to another one is lost
/// (docs/numerics/surface.md has how much).

namespace haarlight::render {

struct Ggx {
  double alpha = 0.1;  ///< 1e-4 to 1

  /// D(h), per sr: its integral times cos_h is 1. @param half  unit, above the surface
  [[nodiscard]] double density_of_normals(const Eigen::Vector3d& half) const;

  /// D G / (4 cos_o cos_i): the reflection without F. Both directions above the surface.
  [[nodiscard]] double reflection(const Eigen::Vector3d& to_eye,
                                  const Eigen::Vector3d& to_light) const;

  /// G(o, i) / G(o): the fraction of the sampled visible facets' light that is not shadowed. It is
  /// reflection() cos_i / density().
  [[nodiscard]] double unshadowed(double cos_eye, double cos_light) const;

  /// Density of the directions reflected at visible normals, per sr.
  [[nodiscard]] double density(const Eigen::Vector3d& to_eye,
                               const Eigen::Vector3d& to_light) const;

  /// A visible normal, drawn from max(0, h.o) D(h) G(o) / cos_o [Heitz18], by the spherical cap
  /// of [Dupuy23]. @param square  in [0, 1)^2
  [[nodiscard]] Eigen::Vector3d visible_normal(const Eigen::Vector3d& to_eye,
                                               const Eigen::Vector2d& square) const;

 private:
  [[nodiscard]] double stretched(double cosine) const;
};

/// @return  `direction` mirrored at the unit normal `half`
[[nodiscard]] inline Eigen::Vector3d mirrored(const Eigen::Vector3d& direction,
                                              const Eigen::Vector3d& half) {
  return 2.0 * half.dot(direction) * half - direction;
}

}  // namespace haarlight::render
