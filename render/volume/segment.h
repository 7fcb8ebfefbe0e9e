// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

/// @file
/// What a ray collects on a segment of a medium that emits and absorbs, I towards the eye,
///
///     dI/ds = g(s) - rho(s) I(s),
///
/// where extinction rho and colour are linear between its ends (exact), or quadratic along it.
/// Source: [Williams98], eq. (5) to (8), in a form that neither overflows nor cancels; derived, and
/// its errors measured, in docs/numerics/volume.md. Colours enter as weights: any number of
/// wavelengths costs one evaluation. Lengths and extinctions have any units inverse to each other.
/// Pure; safe from any thread.

namespace haarlight::render {

/// The largest optical depth, rho times length, that is taken: squares of it stay out of play, and
/// nothing shows beyond 800 anyway.
inline constexpr double kLargestDepth = 1e300;

/// Of what is at the near (the eye's) and at the far end of a segment.
struct EndWeights {
  double near = 0.0;
  double far = 0.0;
};

/// All weights are >= 0. Relative errors at most 1e-14 each where the larger depth is 1e-280 or above.
struct SegmentWeights {
  /// Glow k rho of a chromaticity k [Williams92]: C = k_near near + k_far far. Their sum is the
  /// opacity.
  EndWeights of_chromaticity;
  /// Glow g independent of the extinction [Wilhelms91]: C = L (g_near near + g_far far).
  EndWeights of_glow;
  double opacity = 0.0;       ///< alpha = 1 - T
  double transparency = 1.0;  ///< T, of which the relative error is that of the depth (a + b)/2
};

/// Of a segment with a = rho_near L and b = rho_far L.
/// @param depth_near, depth_far  a and b, 0 .. kLargestDepth
/// @throws ContractViolation  beyond that range, or not a number
[[nodiscard]] SegmentWeights weights_of_depths(double depth_near, double depth_far);

/// Of a segment of length L.
/// @param rho_near, rho_far  >= 0, per unit length
/// @param length             >= 0
/// @throws ContractViolation  negative, not a number, or a depth beyond kLargestDepth
[[nodiscard]] SegmentWeights segment_weights(double rho_near, double rho_far, double length);

/// Results for many segments, of one size all; as SegmentWeights.
struct SegmentSpans {
  std::span<double> chromaticity_near;
  std::span<double> chromaticity_far;
  std::span<double> glow_near;
  std::span<double> glow_far;
  std::span<double> transparency;
};

/// The same bits as weights_of_depths(), of many segments at once in vectors: fastest where
/// neighbours are alike in depth.
/// @throws ContractViolation  as there, or where sizes differ; nothing is written then
void find_weights(std::span<const double> depths_near, std::span<const double> depths_far,
                  const SegmentSpans& weights);

/// f(s) = near (1 - s)^2 + 2 middle s (1 - s) + far s^2, s = 0 at the near end, 1 at the far one:
/// values at the ends, and middle = f(0) + f'(0)/2 = f(1) - f'(1)/2.
struct Parabola {
  double near = 0.0;
  double middle = 0.0;
  double far = 0.0;
};

/// All >= 0 but those of middle, whose polynomial is >= 0 and so is its weight.
struct QuadraticWeights {
  Parabola of_chromaticity;   ///< C = k.near near + k.middle middle + k.far far
  Parabola of_glow;           ///< C = L (g.near near + g.middle middle + g.far far)
  double opacity = 0.0;       ///< of the whole segment
  double transparency = 1.0;  ///< of the whole segment
  int n_pieces = 0;           ///< that were integrated
};

/// Of a segment along which extinction, and chromaticity or glow, are parabolas: by 10-point Gauss on
/// pieces of an optical depth of at most 1/2, from the eye, until what is behind cannot matter.
/// Relative error at most 1e-13 of C. O(pieces): at most 2 + 4 log(1/least_fraction).
/// @param rho          >= 0 along the segment but for rounding (1e-9 of its largest value), which
///                     counts as 0
/// @param length       >= 0
/// @param least_fraction  stop where the transparency up to a point is below it: 0 < fraction < 1. What is
///                     left out is below least_fraction times the largest chromaticity, or glow by
///                     extinction
/// @throws ContractViolation  beyond these ranges, not a number, or a depth beyond kLargestDepth
[[nodiscard]] QuadraticWeights quadratic_weights(const Parabola& rho, double length,
                                                 double least_fraction = 1e-17);

/// The same by the rule of [Williams98]: 5 points over the whole segment, whatever its depth. For
/// comparison alone: relative errors of C up to 2e-4 at a depth of 1, 0.15 at 10 and 1 at 100.
[[nodiscard]] QuadraticWeights five_point_weights(const Parabola& rho, double length);

}  // namespace haarlight::render
