// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "capture/commission/photon_transfer.h"
#include "capture/commission/step_response.h"
#include "core/random.h"
#include "tests/extremes.h"

namespace haarlight::capture {
namespace {

using extremes::both;
using extremes::bounded;
using extremes::exact;
using extremes::stated;

// ---- step response ----

EXTREMES_OF(step, "capture/commission", "timing from a light's step")

/// Exact samples of `n` steps, each seen by 12 rows.
std::vector<StepSample> samples_of(int n, double exposure, double ramp, double scale = 1.0) {
  std::vector<StepSample> samples;
  for (int step = 0; step < n; ++step) {
    for (int row = 0; row < 12; ++row) {
      StepSample s;
      s.step = step;
      s.rises = step % 2 == 0;
      s.exposure_us = exposure * scale;
      s.row = row / 11.0;
      s.after_us = scale * (-1.4 * exposure +
                            1.9 * exposure *
                                uniform_unit(hash_key(6, static_cast<std::uint64_t>(step))));
      // D = 40, skew = 0.3 exposures.
      const double x =
          s.after_us + s.row * 0.3 * exposure * scale + s.exposure_us - 40.0 * scale;
      const double g = lit_fraction(x, s.exposure_us, ramp * scale);
      s.level = s.rises ? g : 1.0 - g;
      samples.push_back(s);
    }
  }
  return samples;
}

EXTREME(step, dark) {
  std::vector<StepSample> samples = samples_of(40, 1000.0, 50.0);
  for (StepSample& s : samples) {
    s.level = 0.0;
  }
  EXPECT_FALSE(fit_steps({}).has_value());
  const auto found = fit_steps(samples);
  EXPECT_TRUE(!found || std::isfinite(found->model.skew_us));
  return stated(
      "no sample: nothing; a light that never comes: nothing, or finite numbers with their "
      "scatter");
}
EXTREME(step, one) {
  EXPECT_FALSE(fit_steps(samples_of(1, 1000.0, 50.0)).has_value());
  return stated("one step: nothing, fewer than four");
}
NO_EXTREME(step, largest, "no limit")
NO_EXTREME(step, odd_size, "rows as they come")
EXTREME(step, scale) {
  double worst = 0.0;
  for (const double s : {1e-9, 1e9}) {
    for (const double x : {-10.0, 0.0, 3.0, 30.0, 500.0, 990.0, 1020.0, 2000.0}) {
      worst = std::max(worst, std::abs(lit_fraction(x * s, 1000.0 * s, 40.0 * s) -
                                       lit_fraction(x, 1000.0, 40.0)));
    }
  }
  return bounded(worst, 1e-12, "times of 1e±9 µs: change of the fraction seen", "6 roundings");
}
NO_EXTREME(step, subnormal, "microseconds")
NO_EXTREME(step, not_finite, "times and levels are computed from whole counts")
EXTREME(step, degenerate) {
  EXPECT_EQ(lit_fraction(-1.0, 1000.0, 0.0), 0.0);
  EXPECT_EQ(lit_fraction(500.0, 1000.0, 0.0), 0.5);
  EXPECT_EQ(lit_fraction(1001.0, 1000.0, 0.0), 1.0);
  // Every step at the same time in the exposure.
  std::vector<StepSample> same = samples_of(40, 1000.0, 50.0);
  for (StepSample& s : same) {
    s.after_us = -3000.0;
    s.level = s.rises ? 0.0 : 1.0;
  }
  EXPECT_FALSE(fit_steps(same).has_value());
  return both(exact("a ramp of 0: 0, x/E, 1"), stated("no step within an exposure: nothing"));
}
NO_EXTREME(step, grazing, "it knows no geometry")
EXTREME(step, far_near) {
  const double longer = lit_fraction(500.0, 1000.0, 1e9);
  return bounded(std::abs(longer / (500.0 * 500.0 / 2e9 / 1000.0) - 1.0), 1e-12,
                 "a ramp of 1e6 exposures: relative error of the fraction seen", "6 roundings");
}
EXTREME(step, duplicate) {
  std::vector<StepSample> samples = samples_of(40, 1000.0, 50.0);
  const std::vector<StepSample> once = samples;
  samples.insert(samples.end(), once.begin(), once.end());
  const auto found = fit_steps(samples);
  EXPECT_TRUE(found.has_value());
  return bounded(
      found ? std::abs(found->model.skew_us - 300.0) : std::numeric_limits<double>::infinity(),
      1.0, "every sample twice: error of the skew of 300, µs", "exact samples, the fit's end");
}
NO_EXTREME(step, clipped, "levels of 0 and 1 are the step's ends")

// ---- photon transfer ----

EXTREMES_OF(transfer, "capture/commission", "noise by photon transfer")

Image<std::uint16_t> flat(int value, int spread = 0, std::uint64_t seed = 0) {
  Image<std::uint16_t> picture(64, 64, 1);
  std::uint64_t i = 0;
  for (std::uint16_t& v : picture.pixels()) {
    v = static_cast<std::uint16_t>(
        value + static_cast<int>(spread * uniform_unit(hash_key(seed, ++i))));
  }
  return picture;
}

std::optional<SensorMeasurement> measured(int first, int step, int n, int spread) {
  TransferCurve curve(4095);
  for (int i = 0; i < n; ++i) {
    const auto seed = 2 * static_cast<std::uint64_t>(i);
    curve.add_pair(flat(first + i * step, spread, seed).view(),
                   flat(first + i * step, spread, seed + 1).view(), 64);
  }
  DarkLevel dark;
  add_dark_pair(flat(64, 4, 91).view(), flat(64, 4, 92).view(), 64, dark);
  std::optional<SensorMeasurement> found = measure_sensor(curve, dark, std::nullopt, 4095, {});
  if (found) {
    EXPECT_TRUE(std::isfinite(found->gain_e_per_dn.value) &&
                std::isfinite(found->read_e.value));
  }
  return found;
}

EXTREME(transfer, dark) {
  TransferCurve curve(4095);
  curve.add_pair(flat(0).view(), flat(0).view(), 64);
  EXPECT_FALSE(measure_sensor(curve, {}, std::nullopt, 4095, {}).has_value());
  DarkLevel dark;
  add_dark_pair(flat(0).view(), flat(0).view(), 64, dark);
  EXPECT_EQ(dark.clipped_fraction, 1.0);
  return stated("black pictures of zeros: nothing, all pixels counted as clipped at 0");
}
EXTREME(transfer, one) {
  EXPECT_FALSE(measured(500, 0, 1, 20).has_value());
  return stated("one level: nothing, fewer than four");
}
NO_EXTREME(transfer, largest, "words of 16 bits")
EXTREME(transfer, odd_size) {
  TransferCurve curve(4095);
  const Image<std::uint16_t> narrow(1, 3, 1);
  curve.add_pair(narrow.view(), narrow.view(), 1);
  curve.add_pair(narrow.view(), narrow.view(), 0);
  EXPECT_FALSE(measure_sensor(curve, {}, std::nullopt, 4095, {}).has_value());
  return stated("3 × 1 pixels, or no row: nothing, too few pairs");
}
NO_EXTREME(transfer, scale, "whole counts")
NO_EXTREME(transfer, subnormal, "whole counts")
NO_EXTREME(transfer, not_finite, "whole counts")
EXTREME(transfer, degenerate) {
  const auto found = measured(300, 250, 12, 0);
  EXPECT_TRUE(!found || found->gain_e_per_dn.value > 0.0);
  return stated("pictures without any noise: nothing, or a gain above 0");
}
NO_EXTREME(transfer, grazing, "it knows no geometry")
NO_EXTREME(transfer, far_near, "it knows no geometry")
EXTREME(transfer, duplicate) {
  EXPECT_FALSE(measured(500, 0, 12, 20).has_value());
  return stated("twelve times the same level: nothing, fewer than four");
}
EXTREME(transfer, clipped) {
  TransferCurve curve(4095);
  for (int i = 0; i < 12; ++i) {
    curve.add_pair(flat(4095).view(), flat(4095).view(), 64);
  }
  for (const TransferBin& bin : curve.bins()) {
    EXPECT_EQ(bin.n, 0.0);
  }
  EXPECT_FALSE(measure_sensor(curve, {}, std::nullopt, 4095, {}).has_value());
  return stated("white pictures: no pair counts, nothing");
}

}  // namespace
}  // namespace haarlight::capture
