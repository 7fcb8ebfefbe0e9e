// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/core/image.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/shape/photometric_stereo.h"

/// @file
/// Tests whether lights known only by direction are as far as the model assumes. A light at
/// distance D from the picture's middle gives a pixel at position p (picture widths) to first
/// order b.s + (3 (s.p)(b.s) - b.p) / D: a part of that no normal explains, which yields 1/D;
/// the rest turns the normals, the more the farther from the middle. Errors:
/// docs/numerics/shape.md.

namespace haarlight::relight {

struct LightNearness {
  double inverse = 0.0;  ///< 1/D, per picture width; 0: far
  double sigma = 0.0;    ///< one standard error of it, by leaving out blocks of the picture
  /// Radians by which a normal turns, per picture width of distance and unit of 1/D (rms).
  double turn = 0.0;
  [[nodiscard]] bool is_near() const noexcept {
    constexpr double kSure = 3.0;
    constexpr double kLeast = 0.02;  // 50 picture widths away: half a degree at the border
    return inverse > kSure * sigma && inverse > kLeast;
  }
};

/// @param surface  pixels are sampled where it is good
/// @param options  the fit that found it
[[nodiscard]] LightNearness find_nearness(const StackSource& stack, const StereoLights& lights,
                                          const SurfaceEstimate& surface,
                                          const StereoOptions& options);

/// Adds the effect on the normals to their standard errors, pixel by pixel.
void add_nearness(const LightNearness& nearness, SurfaceEstimate& surface);

}  // namespace haarlight::relight
