// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include <Eigen/Core>

#include "haarlight/core/image.h"
#include "haarlight/render/scene/scene.h"

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
  double deviation = 0.0;  ///< standard deviation of a value: noise and coding
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
/// lights give 1 +- tolerance and at most `max_bright_fraction` exceed it. An object that is
/// about as bright as the plane under many lights passes this; the height of its surface
/// (height_from_falloff) tells it, where it is more than `max_height`. Figures: docs/numerics/shadow.md.
struct PlaneTest {
  double tolerance = 0.05;
  double min_lit_fraction = 0.2;     ///< fewer: in deep shadow, unknown to be safe
  double max_bright_fraction = 0.1;  ///< noise and coding
  /// Of the lights' mean height over the plane, and three standard errors: light from the object
  /// on the plane makes up to half of it.
  double max_height = 0.02;
};
[[nodiscard]] bool shows_plane(std::span<const float> values, std::span<const float> plate,
                               const PlaneTest& test = {});

/// d ln(plate_falloff)/dh at a point that moves by `step` per mm of h; 0 behind the light.
[[nodiscard]] double falloff_slope(const render::SquareLight& light,
                                   const Eigen::Vector3d& point, const Eigen::Vector3d& normal,
                                   const Eigen::Vector3d& step);

/// Height of the surface that a camera pixel shows, over the plane.
struct SurfaceHeight {
  double mm = 0.0;
  double error_mm = 0.0;  ///< standard error; infinite where the lights cannot tell
};

/// From how T/B varies over the lights within `tolerance` of 1: at height h the falloff is not
/// the plate's, and T/B = c (1 + h falloff_slope) to first order for a surface parallel to the plane, whatever its
/// albedo. Least squares in c and h c.
/// @param slopes  (n_lights): falloff_slope along the pixel's ray, per mm over the plane
[[nodiscard]] SurfaceHeight height_from_falloff(std::span<const float> values,
                                                std::span<const float> plate,
                                                std::span<const double> slopes,
                                                double tolerance);

/// Sets V to 1 where it is 1 but for noise: clamping noise to [0, 1] would darken what is lit by
/// 0.4 of its standard deviation. That of one value is 1.48 median |V - 1| over the values within
/// `tolerance` of 1, most of which are lit; 1 is set where the mean of a pixel and its usable
/// neighbours is not three standard errors less. A shadow fainter than the noise of one value is
/// lost.
/// @param value   (h, w, 1), not clamped
/// @param usable  (h, w, 1)
/// @return        the standard deviation, 0 where nothing is lit
double settle_lit(Image<float>& value, ImageView<const std::uint8_t> usable, double tolerance);

/// A mask's zeros dilated by one pixel to all eight neighbours: pixels on an outline show both.
[[nodiscard]] Image<std::uint8_t> grow_hidden(ImageView<const std::uint8_t> shows_plane);

}  // namespace haarlight::relight
