// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "capture/commission/commission.h"
#include "core/order_statistics.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr double kLongest = 0.9;  // of the frame period
constexpr double kTop = 0.5;      // of white: the most the brightest light may give
constexpr double kLinear = 0.8;   // of the level up to which the sensor was seen to be linear
constexpr double kHigh = 0.85;    // of white: no bright pixel above
constexpr int kAttempts = 4;
constexpr double kGuardUs = 200.0;
constexpr int kDarkFrames = 6;

/// Per-pixel mean of dark pictures.
Image<float> mean_dark(CommissionBench& bench) {
  (void)bench.show({});
  bench.settle();
  const int rows = bench.spec().active_rows;
  Image<float> mean(rows, bench.spec().frame_width, 1);
  for (int i = 0; i < kDarkFrames; ++i) {
    const ArrivedFrame arrived = bench.next_frame();
    for (int y = 0; y < rows; ++y) {
      const auto row = arrived.frame.pixels().row(y);
      for (std::size_t x = 0; x < row.size(); ++x) {
        mean.view().row(y)[x] += static_cast<float>(row[x]) / static_cast<float>(kDarkFrames);
      }
    }
  }
  return mean;
}

LightResponse respond(ImageView<const std::uint16_t> picture, ImageView<const float> dark,
                      double gain_e_per_dn, double dark_variance) {
  double sum = 0.0;
  double variance = 0.0;
  std::array<double, kSurveyBlocks> blocks{};
  std::array<double, kSurveyBlocks> pixels{};
  for (int y = 0; y < dark.height(); ++y) {
    const auto words = picture.row(y);
    const auto base = dark.row(y);
    const int down = y * kSurveyAcross / dark.height() * kSurveyAcross;
    for (std::size_t x = 0; x < words.size(); ++x) {
      const double signal = static_cast<double>(words[x]) - static_cast<double>(base[x]);
      const std::size_t block = static_cast<std::size_t>(down) +
                                x * static_cast<std::size_t>(kSurveyAcross) / words.size();
      blocks[block] += signal;
      pixels[block] += 1.0;
    }
  }
  for (const double block : blocks) {
    sum += block;
  }
  const double n = static_cast<double>(dark.height()) * dark.width();
  variance = std::max(0.0, sum) / gain_e_per_dn + n * dark_variance * (1.0 + 1.0 / kDarkFrames);
  LightResponse r;
  r.signal = sum / n;
  r.sigma = std::sqrt(variance) / n;
  const double floor = dark_variance * (1.0 + 1.0 / kDarkFrames);
  for (std::size_t b = 0; b < blocks.size(); ++b) {
    const double count = std::max(pixels[b], 1.0);
    r.blocks[b] = blocks[b] / count;
    r.block_sigma[b] =
        std::sqrt(std::max(0.0, blocks[b]) / gain_e_per_dn + count * floor) / count;
  }
  return r;
}

/// The counts above dark that 1 % of the pixels exceed.
double bright_level(ImageView<const std::uint16_t> picture, ImageView<const float> dark) {
  std::vector<float> values;
  const int stride = std::max(1, dark.height() * dark.width() / 200000);
  for (int y = 0; y < dark.height(); ++y) {
    const auto words = picture.row(y);
    const auto base = dark.row(y);
    for (auto x = static_cast<std::size_t>(y % stride); x < words.size();
         x += static_cast<std::size_t>(stride)) {
      values.push_back(static_cast<float>(words[x]) - base[x]);
    }
  }
  return static_cast<double>(quantile(values, 0.99));
}

/// Each light's response at one exposure.
struct Responses {
  std::vector<LightResponse> of;
  double brightest = 0.0;  ///< counts above the dark, bright_level() of the brightest picture
};

/// @param most  counts above dark; ends early at a light brighter than that
Responses look_at_lights(CommissionBench& bench, const TimingResult& timing, double exposure,
                         double most, double gain_e_per_dn, const CommissionOptions& options) {
  bench.settle();
  const Image<float> dark = mean_dark(bench);
  // Scatter of single dark pixels, from one more picture.
  double dark_variance = 0.0;
  {
    const ArrivedFrame arrived = bench.next_frame();
    for (int y = 0; y < dark.height(); ++y) {
      const auto row = arrived.frame.pixels().row(y);
      for (std::size_t x = 0; x < row.size(); ++x) {
        const double d =
            static_cast<double>(row[x]) - static_cast<double>(dark.view().row(y)[x]);
        dark_variance += d * d / (1.0 + 1.0 / kDarkFrames);
      }
    }
    dark_variance /= static_cast<double>(dark.height()) * dark.width();
  }
  const StepModel& m = timing.fit.model;
  const double slope = std::round(timing.line.slope);
  const double offset = m.offset_us.front() + slope * (exposure - m.exposures_us.front());
  // First row's exposure begins when the light of this step, and the last one's end, has
  // settled.
  const double spread_us =
      std::max(0.0, timing.latch_most_us.value - timing.verdict.latch_us.value);
  const double wait_us = offset + spread_us + std::max(m.rise_us, m.fall_us) + kGuardUs +
                         std::max(0.0, -m.skew_us);
  const int n = bench.rig().n_lights();
  Responses responses;
  for (int k = 0; k < n && responses.brightest <= most; ++k) {
    const firmware_iface::LatchReceipt receipt =
        bench.show({{k, firmware_iface::registers::kMaxLevel}});
    for (;;) {
      const ArrivedFrame arrived = bench.next_frame();
      const double after = static_cast<double>(arrived.frame.info().timestamp_ns -
                                               settle_reference_ns(receipt)) /
                           1e3;
      if (after >= wait_us) {
        responses.brightest =
            std::max(responses.brightest, bright_level(arrived.frame.pixels(), dark.view()));
        responses.of.push_back(
            respond(arrived.frame.pixels(), dark.view(), gain_e_per_dn, dark_variance));
        break;
      }
    }
    if (options.progress && (k % 8 == 7 || k + 1 == n)) {
      options.progress("lights", (k + 1.0) / n);
    }
  }
  (void)bench.show({});
  return responses;
}

}  // namespace

LightSurvey measure_lights(CommissionBench& bench, const TimingResult& timing,
                           double gain_e_per_dn, const CommissionOptions& options) {
  // The sensor may saturate below white.
  const double top = std::min(kTop * bench.white(), kLinear * timing.linear_dn);
  const double wanted = top / std::max(timing.count_per_us, 1e-12);
  double exposure = bench.set_exposure(std::clamp(wanted, 20.0, kLongest * bench.period_us()));
  // The light that `wanted` is derived from may have been dim or dead: then the others are
  // brighter than expected, and a saturated sensor would look like misplaced lights.
  const double most = std::min(kHigh * bench.white(), timing.linear_dn);
  for (int attempt = 1;; ++attempt) {
    const double limit = attempt < kAttempts ? most : std::numeric_limits<double>::max();
    const Responses responses =
        look_at_lights(bench, timing, exposure, limit, gain_e_per_dn, options);
    if (responses.brightest <= limit) {
      return survey_lights(bench.rig(), bench.camera_index(), responses.of);
    }
    exposure = bench.set_exposure(std::max(20.0, 0.7 * exposure * top / responses.brightest));
  }
}

}  // namespace haarlight::capture
