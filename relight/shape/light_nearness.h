// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "core/image.h"
#include "core/stack/stack_source.h"
#include "relight/shape/photometric_stereo.h"

/// @file
/// Are lights that are known by their directions only as far as the model takes them? A light
/// at distance D of the picture's middle shows a pixel at place p (picture widths) to first
/// order b.s + (3 (s.p)(b.s) - b.p) / D: a part of that no normal explains, which tells 1/D;
/// the rest turns the normals, by more the farther from the middle. Errors:
/// docs/numerics/shape.md.

namespace haarlight {

struct LightNearness {
  double inverse = 0.0;  ///< 1/D, per picture width; 0: far
  double sigma = 0.0;    ///< one standard error of it, by leaving out blocks of the picture
  /// Radians by which a normal turns, for each picture width of place and unit of 1/D (rms).
  double turn = 0.0;
  [[nodiscard]] bool is_near() const noexcept {
    constexpr double kSure = 3.0;
    constexpr double kLeast = 0.02;  // 50 picture widths away: half a degree at the border
    return inverse > kSure * sigma && inverse > kLeast;
  }
};

/// @param surface  where it is good, pixels are sampled
/// @param options  the fit that found it
[[nodiscard]] LightNearness find_nearness(const StackSource& stack, const StereoLights& lights,
                                          const SurfaceEstimate& surface,
                                          const StereoOptions& options);

/// Adds what this does to normals to their standard errors, place by place.
void add_nearness(const LightNearness& nearness, SurfaceEstimate& surface);

}  // namespace haarlight
