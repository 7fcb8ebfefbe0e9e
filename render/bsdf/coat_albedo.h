// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>

/// @file
/// What a rough dielectric coat reflects of light from one direction, and what it lets through: the
/// directional albedo of ggx.h with the Fresnel reflectance of a dielectric, tabulated.
///
/// The table is over ior and (m, v), with m = max(cos, alpha) and v telling which of the two is the
/// larger and by how much: near cos = alpha = 0 the albedo depends on their ratio alone, which a
/// table over (cos, alpha) would resolve nowhere. It errs on one side: the reflectance is never
/// below the true one, at most 0.03 above it, so that a coated surface makes no light
/// (docs/numerics/surface.md).

namespace haarlight::render {

class CoatAlbedo {
 public:
  static constexpr double kLowestIor = 1.2;
  static constexpr double kHighestIor = 2.5;

  /// The table, made when first asked for (about 0.2 s). Thread-safe.
  [[nodiscard]] static const CoatAlbedo& table();

  CoatAlbedo();

  /// At most 1, not below the true one. @param cosine, alpha  0 to 1
  /// @param ior  kLowestIor to kHighestIor
  [[nodiscard]] double reflectance(double cosine, double alpha, double ior) const;

  /// T(cosine): what goes on to the base.
  [[nodiscard]] double transmittance(double cosine, double alpha, double ior) const {
    return 1.0 - reflectance(cosine, alpha, ior);
  }

  /// Not below the mean of transmittance() over the hemisphere, weighted by cos/pi.
  [[nodiscard]] double mean_transmittance(double alpha, double ior) const;

 private:
  static constexpr std::size_t kLevels = 48;  // of m, of m = level^2
  static constexpr std::size_t kAngles = 25;  // of v
  static constexpr std::size_t kIors = 9;     // of (n - 1)/(n + 1)
  static constexpr std::size_t kAlphas = 33;  // of the means, of alpha = (i/32)^2

  std::array<float, kIors * kAngles * kLevels> reflectance_{};
  std::array<float, kIors * kAlphas> mean_transmittance_{};
};

/// The albedo that is tabulated, by quadrature over visible normals: of F(h.o) G(o, i)/G(o).
[[nodiscard]] double coat_reflectance_by_quadrature(double cosine, double alpha, double ior,
                                                    int n_azimuths, int n_heights);

}  // namespace haarlight::render
