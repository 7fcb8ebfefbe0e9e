// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <limits>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "relight/calibration/target_samples.h"

/// @file
/// The normalised variance of a matte target's apparent albedo over the lights, and its
/// gradient: equations (7) and (8) of [Huang15], with a lobe and with masks. Notes:
/// docs/numerics/near-light.md.

namespace haarlight::relight {

/// Gradient of the objective. Powers by their logarithm.
struct VarianceGradient {
  std::vector<Eigen::Vector3d> position;  ///< (K), mm^-1
  std::vector<Eigen::Vector3d> axis;      ///< (K), the axis as three independent numbers
  std::vector<double> log_power;          ///< (K, C)
  double mu = 0.0;                        ///< of an exponent shared by all lights
};

struct VarianceValue {
  /// 0 .. C (1 - 1/K); NaN where a used sample is lit from behind (outside the model).
  double d = std::numeric_limits<double>::quiet_NaN();
  VarianceGradient gradient;  ///< empty unless requested
};

/// D(l, e) = 1/N sum_c sum_p (1 - S1^2 / (K_p S2)), S1 and S2 the sum and the sum of squares
/// over the K_p used lights of A = I g / e, g = |w|^3 / (n.w) / cos^mu, w = l - p. Points with
/// fewer than two used lights carry no information and are left out of N. Powers:
/// NearLight::power of the first C channels. Results do not depend on the number of threads.
/// @param lights  (K); each with its own mu
[[nodiscard]] VarianceValue normalised_variance(const TargetSamples& samples,
                                                std::span<const NearLight> lights,
                                                bool has_gradient);

}  // namespace haarlight::relight
