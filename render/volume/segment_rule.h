// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <vector>

#include "render/volume/segment.h"
#include "render/volume/volume_mode.h"

/// @file
/// Linear segments by the rules that the exact one is compared with. Derivations, costs and errors:
/// docs/numerics/volume.md, "Modes". Pure; safe from any thread.

namespace haarlight::render {

/// Points and weights of Gauss and Legendre's rule on 0..1.
struct GaussPoints {
  std::vector<double> points;
  std::vector<double> weights;
};
/// @param n  1..VolumeRule::kMostPoints
[[nodiscard]] GaussPoints gauss_points(int n);

/// What a rule makes of a segment. The transparency is e^-tau and the opacity 1 - e^-tau in all.
struct RuledWeights {
  SegmentWeights weights;
  int n_pieces = 0;          ///< into which it was cut
  int n_terms = 0;           ///< points or terms that were evaluated
  bool is_finite = true;     ///< else the weights are those of mean_colour_weights()
  bool is_negative = false;  ///< any weight is
  /// Of gauss: half the largest depth that a piece would have if it were as dense as at its peak.
  double peak = 0.0;
  /// Of series: by how much C may be off, over the largest colour at its ends times the opacity, or
  /// of a glow times L (P0, both its weights); rounding included.
  double relative_bound = 0.0;
};

/// alpha/2 for each end, and for a glow half of (1 - T)/tau: [Williams98], section 4.
[[nodiscard]] SegmentWeights mean_colour_weights(double depth_near, double depth_far);

/// Dawson's integral as Rybicki sums it [Rybicki89], h = 0.4, six pairs of terms: 2e-7 off.
/// x >= 0; not a number where x/h is beyond the integers of 32 bits, which its index is one of.
[[nodiscard]] double rybicki_dawson(double x);

/// e^(x^2) erfc(x) for x >= 0 as u e^p(u), u = 1/(1 + x/2) and p of degree 9, about 1e-7 off: the form
/// that [Williams98] takes, with coefficients of our own.
[[nodiscard]] double fitted_erfcx(double x);

class SegmentRule {
 public:
  /// @param rule  of any mode but exact
  explicit SegmentRule(const VolumeRule& rule);

  [[nodiscard]] const VolumeRule& rule() const noexcept { return rule_; }
  [[nodiscard]] const GaussPoints& gauss() const noexcept { return gauss_; }
  /// @param depth_near, depth_far  0..kLargestDepth
  /// @throws ContractViolation  beyond that range, or not a number
  [[nodiscard]] RuledWeights of_depths(double depth_near, double depth_far) const;

 private:
  [[nodiscard]] RuledWeights by_gauss(double a, double b) const;
  [[nodiscard]] RuledWeights by_series(double a, double b) const;

  VolumeRule rule_;
  GaussPoints gauss_;
};

/// By how much n points may be off on a piece from s = 0 to 1 along which the extinction is a
/// polynomial of degree p >= 1 and the colour one of degree q >= 1, the extinction times half of the
/// piece's length is at most `peak`, and the colour at most 1; neither is negative. For a
/// chromaticity over peak, for a glow over half of the length; both over what reaches the eye from
/// the piece's beginning. Rounding apart. Infinite where no useful bound is known.
struct GaussBound {
  double of_chromaticity = 0.0;
  double of_glow = 0.0;
};
[[nodiscard]] GaussBound gauss_bound(int n, double peak, std::size_t p, std::size_t q);

}  // namespace haarlight::render
