// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include <Eigen/Core>

#include "haarlight/core/image.h"
#include "haarlight/render/scene.h"

/// @file
/// From the light transport matrix T to visibility: V_k = T_k/B_k, how much of light k reaches
/// a point of the plane, with B the clean plate. Clamped to [0, 1]; values above 1 (light from
/// the object on the plane) are counted.

namespace haarlight::relight {

/// Counts of a whole job; add them up over pictures.
struct VisibilityCount {
  std::uint64_t n_values = 0;    ///< known ones
  std::uint64_t n_excess = 0;    ///< above 1.02: beyond noise, inter-reflection
  double worst_excess = 0.0;     ///< largest V - 1
  std::uint64_t n_no_plate = 0;  ///< clean plate too dark to divide by: unknown
  void add(const VisibilityCount& other);
  void add_value(double v);
};

/// A picture of V and its unknown pixels.
struct Visibility {
  Image<float> value;         ///< (h, w, 1) in [0, 1]; 0 where unknown
  Image<std::uint8_t> known;  ///< (h, w, 1)
  VisibilityCount count;
};

/// Substitute for a clean plate: cos(theta) cos^mu(theta_l)/r^2 of a small light on the plane,
/// without its scale; 0 behind the light. cos^4/r^2 in its best-known form.
[[nodiscard]] double plate_falloff(const render::SquareLight& light,
                                   const Eigen::Vector3d& point, const Eigen::Vector3d& normal);

/// The scale k of T = k * falloff, from mostly unshadowed values: the median ratio, then the
/// median of the ratios within a quarter of it.
/// @param falloffs  zeros are left out
/// @return          0 when there is nothing to fit
[[nodiscard]] double fit_plate_scale(std::span<const float> values,
                                     std::span<const double> falloffs);

/// Whether a camera pixel shows the plane rather than the object, from its values under all
/// lights. On the plane T/B is 1 for every light that is not blocked and below 1 for the
/// others; on the object it is arbitrary. Says yes when at least `min_lit_fraction` of the
/// lights give 1 +- tolerance and at most `max_bright_fraction` exceed it. Measured on the
/// twin's airplane, compressed to 1 % with and without noise: no plane pixel of 4600 lost, 2
/// object pixels of 491 classified as plane. An object that looks like the plane under many
/// lights is misclassified: provide a mask then.
struct PlaneTest {
  double tolerance = 0.05;
  double min_lit_fraction = 0.2;     ///< fewer: in deep shadow, unknown to be safe
  double max_bright_fraction = 0.1;  ///< noise and coding
};
[[nodiscard]] bool shows_plane(std::span<const float> values, std::span<const float> plate,
                               const PlaneTest& test = {});

/// A mask's zeros dilated by one pixel to all eight neighbours: pixels on an outline show both.
[[nodiscard]] Image<std::uint8_t> grow_hidden(ImageView<const std::uint8_t> shows_plane);

}  // namespace haarlight::relight
