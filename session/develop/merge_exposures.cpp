// SPDX-License-Identifier: Apache-2.0
#include "session/develop/merge_exposures.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "haarlight/core/error.h"

namespace haarlight::session {

namespace {

constexpr int kMaxPasses = 12;
constexpr double kConverged = 1e-3;   // of a standard error: far below the noise
constexpr double kLevelSlack = 0.02;  // of the level: LEDs and exposures are no more accurate
// The weight of a sample falls linearly from 1 to 0 over this span of sigmas below the clip
// level. Selecting by a noisy sample biases by slope * sigma^2: 1/20 of its sigma here.
constexpr double kRampSigmas = 20.0;
constexpr double kRampTopSigmas = 4.0;  // samples clip above it: one in 30000 at its end

/// How far to trust a sample that may be clipped the next time.
double trust(const ExposureSample& s) {
  if (!std::isfinite(s.clip)) {
    return 1.0;
  }
  const double sigma = std::sqrt(s.clip + s.floor);
  const double top = s.clip - kRampTopSigmas * sigma;
  return std::clamp((top - s.electrons) / (kRampSigmas * sigma), 0.0, 1.0);
}

/// Every sample is clipped: the radiance is at least the bound from each.
MergedRadiance lower_bound(std::span<const ExposureSample> samples) {
  MergedRadiance merged;
  merged.is_saturated = true;
  for (const ExposureSample& s : samples) {
    merged.radiance = std::max(merged.radiance, s.clip / s.per_unit);
  }
  return merged;
}

}  // namespace

MergedRadiance merge_by_photons(std::span<const ExposureSample> samples) {
  MergedRadiance merged;
  double signal = 0.0;
  double per_unit = 0.0;
  for (const ExposureSample& s : samples) {
    if (!s.is_clipped()) {
      signal += s.electrons;
      per_unit += s.per_unit;
      ++merged.n_used;
    }
  }
  if (merged.n_used == 0) {
    return lower_bound(samples);
  }
  merged.radiance = signal / per_unit;
  return merged;
}

// With W_i = t_i a_i^2 / v_i, v_i = a_i x + c_i, t_i the trust:
//   x = sum W_i (n_i / a_i) / sum W_i,    var x = sum W_i^2 v_i / a_i^2 / (sum W_i)^2
// iterated in v; an error of v enters x only to second order.
MergedRadiance merge_exposures(std::span<const ExposureSample> samples) {
  HAARLIGHT_EXPECTS(!samples.empty(), "at least one exposure");
  MergedRadiance merged = merge_by_photons(samples);
  if (merged.is_saturated) {
    return merged;
  }
  // The shortest unclipped exposure is trusted fully: nothing can replace it.
  double shortest = std::numeric_limits<double>::infinity();
  for (const ExposureSample& s : samples) {
    shortest = s.is_clipped() ? shortest : std::min(shortest, s.per_unit);
  }
  double x = merged.radiance;
  for (int pass = 0; pass < kMaxPasses; ++pass) {
    double weighted = 0.0;
    double weights = 0.0;
    double spread = 0.0;
    for (const ExposureSample& s : samples) {
      const double t = s.is_clipped() ? 0.0 : s.per_unit <= shortest ? 1.0 : trust(s);
      if (t > 0.0) {
        const double weight = t * s.per_unit / (s.per_unit * std::max(x, 0.0) + s.floor);
        weighted += weight * s.electrons;
        weights += weight * s.per_unit;
        spread += weight * t * s.per_unit;
      }
    }
    const double before = std::exchange(x, weighted / weights);
    merged.variance = spread / (weights * weights);
    const double step = x - before;
    if (step * step < kConverged * kConverged * merged.variance) {
      break;
    }
  }
  merged.radiance = x;
  for (const ExposureSample& s : samples) {
    if (!s.is_clipped()) {
      const double expected = s.per_unit * std::max(x, 0.0);
      const double slack = kLevelSlack * expected;
      const double residual = s.electrons - s.per_unit * x;
      merged.chi_square += residual * residual / (expected + s.floor + slack * slack);
    }
  }
  return merged;
}

}  // namespace haarlight::session
