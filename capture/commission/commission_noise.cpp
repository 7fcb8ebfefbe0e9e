// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>

#include "capture/commission/commission.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr double kLongest = 0.9;         // of the frame period: keeps the frame rate
constexpr double kPixelPairs = 60000.0;  // per level: 0.6 % of its variance
constexpr std::size_t kMaxLinearityPixels = 65536;
/// Of the exposure that brings the median pixel to saturation.
constexpr std::array kLevels{0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9};
constexpr double kSafe = 0.6;  // of the level up to which the sensor was seen to be linear
constexpr double kOver = 1.6;
constexpr double kNearlyDark = 0.1;  // of the light expected
constexpr double kFarOver = 2.4;

/// The same pixels of every picture, spread evenly.
std::vector<double> sample_pixels(ImageView<const std::uint16_t> pixels, int rows) {
  const std::size_t all =
      static_cast<std::size_t>(rows) * static_cast<std::size_t>(pixels.width());
  const std::size_t stride = std::max<std::size_t>(1, all / kMaxLinearityPixels);
  std::vector<double> values;
  for (std::size_t i = 0; i < all; i += stride) {
    const auto width = static_cast<std::size_t>(pixels.width());
    values.push_back(static_cast<double>(pixels.row(static_cast<int>(i / width))[i % width]));
  }
  return values;
}

void expect_exposure(const CommissionBench& bench, const Frame& frame, double wanted_us) {
  const double in_force = frame.info().exposure_us;
  if (in_force > 0.0 && std::abs(in_force - wanted_us) > 0.01 * wanted_us) {
    throw Error(
        fmt::format("the camera exposes {:.1f} us, {:.1f} us were set", in_force, wanted_us),
        bench.spec().device, "is automatic exposure on?", ExitCode::unavailable);
  }
}

DarkLevel measure_dark(CommissionBench& bench, double exposure_us, int n_pairs) {
  DarkLevel dark;
  (void)bench.set_exposure(exposure_us);
  (void)bench.show({});
  bench.settle();
  for (int i = 0; i < n_pairs; ++i) {
    const ArrivedFrame first = bench.next_frame();
    const ArrivedFrame second = bench.next_frame();
    add_dark_pair(first.frame.pixels(), second.frame.pixels(), bench.spec().active_rows, dark);
  }
  return dark;
}

/// As many lights on as put twice saturation within reach of the exposure `longest`.
/// @return  the median pixel's rate in counts per us
double light_up(CommissionBench& bench, const TimingResult& timing, double dark_dn,
                double longest) {
  const double per_light = std::max(timing.count_per_us, 1e-12);
  const double needed = kFarOver * 1.5 * bench.white() / (per_light * longest);
  int n = static_cast<int>(
      std::clamp(std::ceil(needed), 1.0, static_cast<double>(bench.n_allowed())));
  const double safe_dn = std::min(0.3 * bench.white(), kSafe * timing.linear_dn);
  double rate = 0.0;
  for (;;) {
    const LightPattern pattern = bench.brightest(n);
    (void)bench.set_exposure(std::min(timing.long_us, safe_dn / (per_light * n)));
    const SteadyLevel lit = bench.look_steady(pattern, 4);
    rate = (lit.median - dark_dn) / bench.exposure_us();
    // Those expected to be brightest may be dead: then use more.
    if (rate >= kNearlyDark * per_light * n || n >= bench.n_allowed()) {
      break;
    }
    n = std::min(2 * n, bench.n_allowed());
  }
  if (!(rate > 0.0)) {
    throw Error("the picture's median pixel sees no light", bench.rig().file.string(),
                "let the camera look at a white card or the empty plane");
  }
  return rate;
}

/// From two exposures beyond it, where that is attainable: a sensor may saturate far below white.
std::optional<double> look_for_saturation(CommissionBench& bench, double dark_dn, double rate,
                                          double longest) {
  const double far = std::min(kFarOver * (bench.white() - dark_dn) / rate, longest);
  (void)bench.set_exposure(far * kOver / kFarOver);
  bench.settle();
  const ArrivedFrame shorter = bench.next_frame();
  const double shorter_us = bench.exposure_us();
  (void)bench.set_exposure(far);
  bench.settle();
  const ArrivedFrame longer = bench.next_frame();
  return find_saturation(shorter.frame.pixels(), longer.frame.pixels(),
                         bench.spec().active_rows, bench.exposure_us() / shorter_us, dark_dn);
}

/// Adds pairs at the exposure in force, `set` us.
/// @return  the sampled pixels' means
std::vector<double> add_pairs(CommissionBench& bench, double set, int n_pairs,
                              TransferCurve& curve) {
  const int rows = bench.spec().active_rows;
  std::vector<double> mean;
  for (int pair = 0; pair < n_pairs; ++pair) {
    const ArrivedFrame first = bench.next_frame();
    const ArrivedFrame second = bench.next_frame();
    expect_exposure(bench, first.frame, set);
    expect_exposure(bench, second.frame, set);
    curve.add_pair(first.frame.pixels(), second.frame.pixels(), rows);
    for (const Frame* frame : {&first.frame, &second.frame}) {
      const std::vector<double> values = sample_pixels(frame->pixels(), rows);
      mean.resize(values.size(), 0.0);
      for (std::size_t j = 0; j < values.size(); ++j) {
        mean[j] += values[j] / (2.0 * n_pairs);
      }
    }
  }
  return mean;
}

/// Means over the pixels that no level of the series brings near saturation, `top`; the levels
/// that keep a quarter of the pixels, three at least.
std::vector<ExposureLevel> linear_levels(const std::vector<std::vector<double>>& sampled,
                                         const std::vector<double>& exposures_us, double top) {
  std::vector<std::size_t> kept;
  std::size_t last = sampled.size();
  while (last > 3 && kept.size() < sampled.front().size() / 4) {
    --last;
    kept.clear();
    for (std::size_t j = 0; j < sampled[last].size(); ++j) {
      if (sampled[last][j] < top) {
        kept.push_back(j);
      }
    }
  }
  std::vector<ExposureLevel> levels;
  for (std::size_t i = 0; i <= last && !kept.empty(); ++i) {
    double sum = 0.0;
    for (const std::size_t j : kept) {
      sum += sampled[i][j];
    }
    levels.push_back({exposures_us[i], sum / static_cast<double>(kept.size())});
  }
  return levels;
}

}  // namespace

NoiseResult measure_noise(CommissionBench& bench, const TimingResult& timing,
                          const CommissionOptions& options) {
  const auto progress = [&](double fraction) {
    if (options.progress) {
      options.progress("noise", fraction);
    }
  };
  const double pixels =
      static_cast<double>(bench.spec().active_rows) * bench.spec().frame_width;
  const int n_pairs = static_cast<int>(std::clamp(std::ceil(kPixelPairs / pixels), 4.0, 48.0));
  const double longest = kLongest * bench.period_us();
  TransferCurve curve(bench.white());
  // Dark first, at the shortest exposure of the series.
  const DarkLevel dark = measure_dark(bench, timing.short_us, n_pairs);
  progress(0.1);
  const double rate = light_up(bench, timing, dark.mean_dn, longest);
  // The levels then stop below it.
  const std::optional<double> saturation =
      look_for_saturation(bench, dark.mean_dn, rate, longest);
  const double range_dn = saturation.value_or(bench.white()) - dark.mean_dn;
  const double to_full = std::min(range_dn / rate, longest);
  std::vector<std::vector<double>> sampled;
  std::vector<double> exposures_us;
  for (std::size_t i = 0; i < kLevels.size(); ++i) {
    exposures_us.push_back(bench.set_exposure(std::max(1.0, kLevels[i] * to_full)));
    bench.settle();
    sampled.push_back(add_pairs(bench, exposures_us.back(), n_pairs, curve));
    progress(0.1 + 0.75 * (static_cast<double>(i) + 1.0) / static_cast<double>(kLevels.size()));
  }
  NoiseResult result;
  result.levels = linear_levels(sampled, exposures_us, dark.mean_dn + 0.9 * range_dn);
  const std::optional<SensorMeasurement> sensor =
      measure_sensor(curve, dark, saturation, bench.white(), result.levels);
  if (!sensor) {
    throw Error("too few levels of light to measure the camera's noise",
                bench.rig().file.string(),
                "let the camera look at a white card or the empty plane; is automatic "
                "exposure or gain on?");
  }
  result.bins = curve.bins();
  result.sensor = *sensor;
  progress(1.0);
  return result;
}

}  // namespace haarlight::capture
