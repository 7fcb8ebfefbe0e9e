// SPDX-License-Identifier: Apache-2.0
/// @file
/// The estimator against synthetic frames of known radiance: Poisson light, normal read noise,
/// rounding, clipping. The Cramer-Rao bound is that of the true distribution (Poisson convolved
/// with the normal), by summation.

#include "session/develop/merge_exposures.h"

#include <array>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <random>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

namespace haarlight::session {
namespace {

struct Camera {
  double read_e = 3.0;
  double electrons_per_dn = 1.0;
  double full_well_e = 16000.0;
};

/// A bracket of n exposures, each `ratio` times the one before; radiance 1 = 1 electron in the
/// shortest.
std::vector<double> bracket(int n, double ratio) {
  std::vector<double> a;
  for (int i = 0; i < n; ++i) {
    a.push_back(std::pow(ratio, i));
  }
  return a;
}

/// Fisher information of lambda in n ~ Poisson(lambda) + N(0, r^2), by summing the density.
/// Above 400 electrons 1 / (lambda + r^2) + 1 / (2 lambda^2) agrees to 1e-4.
double fisher_information(double lambda, double r) {
  if (lambda > 400.0) {
    const double variance = lambda + r * r;
    return 1.0 / variance + 0.5 / (variance * variance);
  }
  const int top = static_cast<int>(lambda + 12.0 * std::sqrt(lambda) + 20.0);
  std::vector<double> p(static_cast<std::size_t>(top) + 1);
  for (int k = 0; k <= top; ++k) {
    p[static_cast<std::size_t>(k)] =
        lambda > 0.0 ? std::exp(k * std::log(lambda) - lambda - std::lgamma(k + 1.0)) : 0.0;
  }
  double information = 0.0;
  const double step = r / 12.0;
  const int n_steps = static_cast<int>((top + 16.0 * r) / step);
  for (int i = 0; i < n_steps; ++i) {
    const double n = -8.0 * r + i * step;
    double density = 0.0;
    double slope = 0.0;
    for (int k = 0; k <= top; ++k) {
      const double z = (n - k) / r;
      if (std::abs(z) < 9.0) {
        const double g = p[static_cast<std::size_t>(k)] * std::exp(-0.5 * z * z) / r *
                         std::numbers::inv_sqrtpi / std::numbers::sqrt2;
        density += g;
        slope += g * (k / lambda - 1.0);
      }
    }
    if (density > 1e-290) {
      information += slope * slope / density * step;
    }
  }
  return information;
}

struct Outcome {
  double bias_sigmas = 0.0;     ///< of the mean, in its own standard errors
  double bias_fraction = 0.0;   ///< relative to the truth
  double variance_ratio = 0.0;  ///< measured / Cramer-Rao bound
  double reported_ratio = 0.0;  ///< reported / measured
  double achieved_sd = 0.0;
  double bound_sd = 0.0;
};

Outcome measure(const Camera& camera, const std::vector<double>& a, double radiance,
                int n_trials, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal(0.0, camera.read_e);
  const double step = camera.electrons_per_dn;
  double bound = 0.0;
  std::vector<std::poisson_distribution<int>> light;
  for (const double a_i : a) {
    const double lambda = a_i * radiance;
    light.emplace_back(lambda);
    // Exposures that (nearly) always clip tell nothing.
    if (lambda + 5.0 * std::sqrt(lambda) < camera.full_well_e) {
      const double r = std::sqrt(camera.read_e * camera.read_e + step * step / 12.0);
      bound += a_i * a_i * fisher_information(lambda, r);
    }
  }
  double sum = 0.0;
  double sum_squares = 0.0;
  double sum_reported = 0.0;
  std::vector<ExposureSample> samples(a.size());
  for (int trial = 0; trial < n_trials; ++trial) {
    for (std::size_t i = 0; i < a.size(); ++i) {
      const double e = light[i](random) + normal(random);
      const double words = std::round(std::min(e, camera.full_well_e) / step);
      samples[i] = {words * step, a[i], camera.read_e * camera.read_e + step * step / 12.0,
                    camera.full_well_e - 0.5 * step};
    }
    const MergedRadiance merged = merge_exposures(samples);
    const double d = merged.radiance - radiance;
    sum += d;
    sum_squares += d * d;
    sum_reported += merged.variance;
  }
  Outcome out;
  const double mean = sum / n_trials;
  const double variance = sum_squares / n_trials - mean * mean;
  out.bias_sigmas = mean / std::sqrt(variance / n_trials);
  out.bias_fraction = mean / radiance;
  out.variance_ratio = variance * bound;
  out.reported_ratio = sum_reported / n_trials / variance;
  out.achieved_sd = std::sqrt(variance);
  out.bound_sd = 1.0 / std::sqrt(bound);
  return out;
}

constexpr int kTrials = 40000;  // standard error of a variance: sqrt(2 / 40000) = 0.7 %

TEST(MergeExposures, IsUnbiasedAndReachesTheCramerRaoBound) {
  const std::vector<double> a = bracket(3, 8.0);
  fmt::print("{:>9} {:>10} {:>10} {:>8} {:>9} {:>9}\n", "radiance", "sd", "CRB sd", "var/CRB",
             "bias/sd", "rep/meas");
  for (const double radiance :
       {0.02, 0.1, 0.5, 2.0, 10.0, 60.0, 150.0, 1000.0, 1500.0, 6000.0, 15000.0}) {
    const Outcome out = measure({}, a, radiance, kTrials, 7);
    fmt::print("{:9g} {:10.4g} {:10.4g} {:8.4f} {:9.4f} {:9.4f}\n", radiance, out.achieved_sd,
               out.bound_sd, out.variance_ratio, out.bias_fraction * radiance / out.achieved_sd,
               out.reported_ratio);
    // Limits: 4 standard errors of 40000 trials besides what docs/numerics/exposure.md states.
    EXPECT_LT(std::abs(out.bias_fraction * radiance / out.achieved_sd), 0.03) << radiance;
    EXPECT_GT(out.variance_ratio, 1.0 - 4.0 * 0.0071) << radiance;
    EXPECT_LT(out.variance_ratio, 1.05 + 4.0 * 0.0071) << radiance;
    EXPECT_NEAR(out.reported_ratio, 1.0, radiance < 0.05 ? 0.09 : 0.04) << radiance;
  }
}

TEST(MergeExposures, IsUnbiasedWhereTheLongExposureNearsTheFullWell) {
  // Mean of the long exposure from 30 sigmas below the full well to 5 above.
  const std::vector<double> a = {1.0, 8.0};
  const double sigma = std::sqrt(16000.0);
  double worst = 0.0;
  double worst_left_out = 0.0;
  for (int step = -30; step <= 5; step += step < -6 ? 4 : 1) {
    const double radiance = (16000.0 + step * sigma) / 8.0;
    const Outcome out = measure({}, a, radiance, kTrials / 2, 11);
    worst = std::max(worst, std::abs(out.bias_fraction * radiance / out.achieved_sd));
    // The common method, clipped samples simply left out, for comparison.
    std::mt19937_64 random(11);
    double sum = 0.0;
    double sum_squares = 0.0;
    for (int trial = 0; trial < kTrials / 2; ++trial) {
      std::array<ExposureSample, 2> samples;
      for (std::size_t i = 0; i < 2; ++i) {
        const double e = std::poisson_distribution<int>(a[i] * radiance)(random);
        samples[i] = {std::min(e, 16000.0), a[i], 9.0, 16000.0};
      }
      const double d = merge_by_photons(samples).radiance - radiance;
      sum += d;
      sum_squares += d * d;
    }
    worst_left_out =
        std::max(worst_left_out, std::abs(sum) / std::sqrt(sum_squares * kTrials / 2));
  }
  fmt::print("worst bias near the full well: {:.3f} sd with the ramp, {:.3f} sd left out\n",
             worst, worst_left_out);
  EXPECT_LT(worst, 0.08 + 3.0 / std::sqrt(kTrials / 2.0));
  EXPECT_GT(worst_left_out, 0.15);
}

TEST(MergeExposures, GainsTheDynamicRangeOfTheExposureRatio) {
  // Range: from the radiance with a signal to noise ratio of 1 to the one that clips all.
  const auto darkest = [](const std::vector<double>& a) {
    double low = 1e-4;
    double high = 100.0;
    while (high / low > 1.0005) {
      const double x = std::sqrt(low * high);
      double information = 0.0;
      for (const double a_i : a) {
        information += a_i * a_i / (a_i * x + 9.0);
      }
      (x * x * information > 1.0 ? high : low) = x;
    }
    return high;
  };
  const std::vector<double> one = {1.0};
  const std::vector<double> three = bracket(3, 8.0);
  const double single = 20.0 * std::log10(16000.0 / darkest(one));
  const double merged = 20.0 * std::log10(16000.0 / darkest(three));
  const double seen = measure({}, three, darkest(three), kTrials, 3).achieved_sd;
  fmt::print(
      "dynamic range: {:.1f} dB in one exposure, {:.1f} dB in 1:8:64 (64 = {:.1f} dB); "
      "SNR at its lower end {:.3f}\n",
      single, merged, 20.0 * std::log10(64.0), darkest(three) / seen);
  EXPECT_NEAR(merged - single, 20.0 * std::log10(64.0), 0.3);
  EXPECT_NEAR(darkest(three) / seen, 1.0, 0.03);
}

TEST(MergeExposures, BeatsPhotonWeightsInTheDark) {
  const std::vector<double> a = bracket(4, 4.0);
  const double radiance = 0.05;
  const Outcome out = measure({}, a, radiance, kTrials, 5);
  // Photon weights: sum n / sum a; variance sum (a x + r^2) / (sum a)^2.
  double total = 0.0;
  double variance = 0.0;
  for (const double a_i : a) {
    total += a_i;
    variance += a_i * radiance + 9.0;
  }
  const double photon_sd = std::sqrt(variance) / total;
  fmt::print("dark pixel, 1:4:16:64: {:.4f} by measured noise, {:.4f} by photons ({:.2f} x)\n",
             out.achieved_sd, photon_sd, photon_sd / out.achieved_sd);
  EXPECT_GT(photon_sd / out.achieved_sd, 1.3);
}

TEST(MergeExposures, MarksWhatIsSaturatedInAll) {
  const std::array<ExposureSample, 2> samples{ExposureSample{16000.0, 1.0, 9.0, 16000.0},
                                              ExposureSample{16000.0, 8.0, 9.0, 16000.0}};
  const MergedRadiance merged = merge_exposures(samples);
  EXPECT_TRUE(merged.is_saturated);
  EXPECT_EQ(merged.radiance, 16000.0);  // the shortest exposure's bound, no more
  EXPECT_EQ(merged.n_used, 0);
}

TEST(MergeExposures, OneExposureIsItself) {
  const ExposureSample sample{120.0, 4.0, 9.0, 16000.0};
  const MergedRadiance merged = merge_exposures(std::span(&sample, 1));
  EXPECT_DOUBLE_EQ(merged.radiance, 30.0);
  EXPECT_NEAR(merged.variance, (120.0 + 9.0) / 16.0, 1e-9);
  EXPECT_EQ(merged.chi_square, 0.0);
}

TEST(MergeExposures, AMovedPixelShowsInChiSquare) {
  const std::array<ExposureSample, 2> still{ExposureSample{1000.0, 1.0, 9.0, 16000.0},
                                            ExposureSample{8100.0, 8.0, 9.0, 16000.0}};
  const std::array<ExposureSample, 2> moved{ExposureSample{1000.0, 1.0, 9.0, 16000.0},
                                            ExposureSample{4000.0, 8.0, 9.0, 16000.0}};
  EXPECT_LT(merge_exposures(still).chi_square, 4.0);
  EXPECT_GT(merge_exposures(moved).chi_square, 100.0);
}

RC_GTEST_PROP(MergeExposures, ScalesWithTheUnitAndForgetsTheOrder, ()) {
  const int n = *rc::gen::inRange(1, 17);
  const double unit = *rc::gen::inRange(1, 1000) * 0.01;
  std::vector<ExposureSample> samples;
  for (int i = 0; i < n; ++i) {
    samples.push_back({*rc::gen::inRange(-20, 1600000) * 0.01,
                       *rc::gen::inRange(1, 10000) * 0.01, 9.0, 15000.0});
  }
  const MergedRadiance merged = merge_exposures(samples);
  RC_ASSERT(std::isfinite(merged.radiance));
  RC_ASSERT(merged.is_saturated == (merged.n_used == 0));
  RC_ASSERT(merged.is_saturated || merged.variance > 0.0);
  std::vector<ExposureSample> others(samples.rbegin(), samples.rend());
  for (ExposureSample& s : others) {
    s.per_unit *= unit;
  }
  const MergedRadiance other = merge_exposures(others);
  const double sigma = std::sqrt(merged.variance);
  // Both stop within 1e-3 of a standard error of the fixed point.
  RC_ASSERT(std::abs(other.radiance * unit - merged.radiance) <=
            0.01 * sigma + 1e-9 * std::abs(merged.radiance));
}

}  // namespace
}  // namespace haarlight::session
