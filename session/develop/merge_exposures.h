// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <limits>
#include <span>

/// @file
/// Radiance of one pixel from several exposures under the camera's measured noise: each sample
/// is n ~ Poisson(a x) + N(0, c), of variance a x + c at the common estimate x (not at each
/// noisy sample, which would bias). The weights a^2 / (a x + c) are those of [Granados10] and
/// [Hasinoff10]. Samples near the clip level lose their weight gradually, over 20 of their
/// sigmas: a hard limit would keep a sample only when its noise is low, which biases; the ramp
/// leaves less than 0.1 sigma. Accuracy: docs/numerics/exposure.md.

namespace haarlight::session {

/// One exposure of one pixel.
struct ExposureSample {
  double electrons = 0.0;  ///< n, black and dark subtracted
  double per_unit = 1.0;   ///< a > 0: electrons expected of radiance 1
  double floor = 0.0;      ///< c > 0: variance without light, electrons^2
  /// Electrons at which a sample is clipped; a clipped sample has `electrons` >= clip.
  double clip = std::numeric_limits<double>::infinity();
  [[nodiscard]] bool is_clipped() const { return electrons >= clip; }
};

struct MergedRadiance {
  double radiance = 0.0;  ///< may be negative. Saturated: the greatest lower bound
  double variance = 0.0;  ///< of `radiance`; 0 where saturated
  /// Sum of squared residuals over their variance (plus a tolerance of 2 % of the level) of the
  /// unclipped samples.
  double chi_square = 0.0;
  int n_used = 0;             ///< unclipped samples
  bool is_saturated = false;  ///< every sample is clipped
};

/// @param samples  at least one
/// Pure; O(samples), 2 to 4 passes.
[[nodiscard]] MergedRadiance merge_exposures(std::span<const ExposureSample> samples);

/// The same for a camera with unmeasured noise: sum of signals / sum of a over the unclipped
/// samples, the best weights under photon noise alone. Variance and chi_square are 0.
[[nodiscard]] MergedRadiance merge_by_photons(std::span<const ExposureSample> samples);

}  // namespace haarlight::session
