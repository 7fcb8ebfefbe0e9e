// SPDX-License-Identifier: Apache-2.0
#include "capture/commission/photon_transfer.h"

#include <algorithm>
#include <cmath>

#include "core/order_statistics.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr int kBins = 128;
constexpr double kMinPairs = 30.0;        // per picture pair: below it a bin says nothing
constexpr double kMinDegrees = 100.0;     // a bin needs to enter the fit: 14 % of its variance
constexpr double kFitTop = 0.7;           // of saturation [Emva21]
constexpr double kRounding = 1.0 / 12.0;  // variance of rounding to whole counts
constexpr double kLeastFull = 8.0;        // counts: below this, saturation cannot be detected
constexpr double kBeyond = 0.05;          // of the saturation level: a pixel exceeds it
constexpr double kBeyondFraction =
    0.01;                       // of the pixels: with more of them it is not saturation
constexpr double kStill = 0.1;  // of the expected growth: this pixel is saturated

/// Deviation of the points from the straight line through the middle 90 % of the range, in
/// percent of the signal [Emva21].
std::optional<Measured> linearity(std::span<const ExposureLevel> levels, double black_dn) {
  double top = 0.0;
  for (const ExposureLevel& l : levels) {
    top = std::max(top, l.mean_dn - black_dn);
  }
  double s = 0.0;
  double sx = 0.0;
  double sy = 0.0;
  double sxx = 0.0;
  double sxy = 0.0;
  std::vector<ExposureLevel> used;
  for (const ExposureLevel& l : levels) {
    const double y = l.mean_dn - black_dn;
    if (y < 0.05 * top || y > 0.95 * top) {
      continue;
    }
    // Relative residuals count, so the weight is 1 / y^2.
    const double w = 1.0 / (y * y);
    s += w;
    sx += w * l.exposure_us;
    sy += w * y;
    sxx += w * l.exposure_us * l.exposure_us;
    sxy += w * l.exposure_us * y;
    used.push_back(l);
  }
  const double det = s * sxx - sx * sx;
  if (used.size() < 3 || !(det > 0.0)) {
    return std::nullopt;
  }
  const double b = (s * sxy - sx * sy) / det;
  const double a = (sy - b * sx) / s;
  double worst = 0.0;
  double square = 0.0;
  for (const ExposureLevel& l : used) {
    const double r = (l.mean_dn - black_dn) / (a + b * l.exposure_us) - 1.0;
    worst = std::max(worst, std::abs(r));
    square += r * r;
  }
  const double rms = std::sqrt(square / static_cast<double>(used.size() - 2));
  return Measured{100.0 * worst, 100.0 * rms, static_cast<std::int64_t>(used.size())};
}

}  // namespace

TransferCurve::TransferCurve(int white)
    : white_(white), bins_(kBins), scratch_(4 * bins_.size()) {
  HAARLIGHT_EXPECTS(white > 0 && white < 65536, "a white level of a 16-bit word");
}

void TransferCurve::add_pair(ImageView<const std::uint16_t> first,
                             ImageView<const std::uint16_t> second, int rows) {
  HAARLIGHT_EXPECTS(
      first.width() == second.width() && rows <= first.height() && rows <= second.height(),
      "two pictures of one size");
  // For each level: pairs, sum of levels, sum of differences, sum of squared differences.
  std::fill(scratch_.begin(), scratch_.end(), 0.0);
  const double to_bin = static_cast<double>(kBins) / (white_ + 1.0);
  for (int y = 0; y < rows; ++y) {
    const auto a = first.row(y);
    const auto b = second.row(y);
    for (std::size_t x = 0; x < a.size(); ++x) {
      if (a[x] == 0 || b[x] == 0 || a[x] >= white_ || b[x] >= white_) {
        continue;
      }
      const double level = 0.5 * (static_cast<double>(a[x]) + static_cast<double>(b[x]));
      const double difference = static_cast<double>(a[x]) - static_cast<double>(b[x]);
      double* sums = scratch_.data() + 4 * static_cast<std::size_t>(level * to_bin);
      sums[0] += 1.0;
      sums[1] += level;
      sums[2] += difference;
      sums[3] += difference * difference;
    }
  }
  for (std::size_t i = 0; i < kBins; ++i) {
    const double* sums = scratch_.data() + 4 * i;
    if (sums[0] < kMinPairs) {
      continue;
    }
    // The mean difference is the light's change between the pictures, not noise.
    TransferBin& bin = bins_[i];
    bin.degrees += sums[0] - 1.0;
    bin.sum_square += 0.5 * (sums[3] - sums[2] * sums[2] / sums[0]);
    bin.n += sums[0];
    bin.sum_level += sums[1];
  }
}

void add_dark_pair(ImageView<const std::uint16_t> first, ImageView<const std::uint16_t> second,
                   int rows, DarkLevel& dark) {
  double n = 0.0;
  double level = 0.0;
  double sum = 0.0;
  double square = 0.0;
  double clipped = 0.0;
  for (int y = 0; y < rows; ++y) {
    const auto a = first.row(y);
    const auto b = second.row(y);
    for (std::size_t x = 0; x < a.size(); ++x) {
      const double d = static_cast<double>(a[x]) - static_cast<double>(b[x]);
      level += 0.5 * (static_cast<double>(a[x]) + static_cast<double>(b[x]));
      sum += d;
      square += d * d;
      n += 1.0;
      clipped += a[x] == 0 ? 0.5 : 0.0;
      clipped += b[x] == 0 ? 0.5 : 0.0;
    }
  }
  if (n < 2.0) {
    return;
  }
  const double variance = 0.5 * (square - sum * sum / n) / (n - 1.0);
  const double all = dark.n + n;
  dark.mean_dn = (dark.mean_dn * dark.n + level) / all;
  dark.clipped_fraction = (dark.clipped_fraction * dark.n + clipped) / all;
  dark.variance_dn2 =
      (dark.variance_dn2 * dark.degrees + variance * (n - 1.0)) / (dark.degrees + n - 1.0);
  dark.degrees += n - 1.0;
  dark.n = all;
}

std::optional<double> find_saturation(ImageView<const std::uint16_t> shorter,
                                      ImageView<const std::uint16_t> longer, int rows,
                                      double ratio, double black_dn) {
  HAARLIGHT_EXPECTS(ratio > 1.2, "exposures that differ clearly");
  std::vector<std::uint16_t> full;
  std::vector<std::uint16_t> all;
  std::uint16_t top = 0;
  for (int y = 0; y < rows; ++y) {
    for (const std::uint16_t word : longer.row(y)) {
      top = std::max(top, word);
    }
  }
  // Below half of the brightest signal nothing is saturated, and noise alone may keep a pixel
  // constant.
  const double least = 0.5 * (static_cast<double>(top) - black_dn);
  for (int y = 0; y < rows; ++y) {
    const auto a = shorter.row(y);
    const auto b = longer.row(y);
    for (std::size_t x = 0; x < a.size(); ++x) {
      const double signal = static_cast<double>(a[x]) - black_dn;
      const double growth = static_cast<double>(b[x]) - static_cast<double>(a[x]);
      all.push_back(b[x]);
      if (signal > least && signal > kLeastFull && growth < kStill * (ratio - 1.0) * signal) {
        full.push_back(b[x]);
      }
    }
  }
  if (full.size() < 50) {
    return std::nullopt;
  }
  const auto middle = upper_median(full);
  // At saturation no pixel goes beyond: else these were constant by noise.
  const double limit = middle + kBeyond * (static_cast<double>(middle) - black_dn);
  const auto beyond = std::count_if(all.begin(), all.end(),
                                    [limit](std::uint16_t word) { return word > limit; });
  if (static_cast<double>(beyond) > kBeyondFraction * static_cast<double>(all.size())) {
    return std::nullopt;
  }
  return static_cast<double>(middle);
}

std::optional<SensorMeasurement> measure_sensor(const TransferCurve& curve,
                                                const DarkLevel& dark,
                                                std::optional<double> saturation_dn, int white,
                                                std::span<const ExposureLevel> levels) {
  const double top = saturation_dn.value_or(static_cast<double>(white));
  const double limit = dark.mean_dn + kFitTop * (top - dark.mean_dn);
  std::vector<const TransferBin*> used;
  double pairs = 0.0;
  for (const TransferBin& bin : curve.bins()) {
    if (bin.degrees >= kMinDegrees && bin.level() < limit) {
      used.push_back(&bin);
      pairs += bin.n;
    }
  }
  const bool is_dark_good = dark.degrees > 0.0 && dark.clipped_fraction < 1e-3;
  if (used.size() < 4) {
    return std::nullopt;
  }
  // variance = v0 + k (level - black), each point of relative sigma sqrt(2 / degrees); the
  // weights follow the fit. The dark pictures are a point of their own.
  double v0 = is_dark_good ? dark.variance_dn2 : 1.0;
  double k = 1.0;
  double det = 1.0;
  double sw = 0.0;
  double sx = 0.0;
  double sxx = 0.0;
  double chi2 = 0.0;
  for (int iteration = 0; iteration < 20; ++iteration) {
    sw = sx = sxx = chi2 = 0.0;
    double sy = 0.0;
    double sxy = 0.0;
    const auto add = [&](double x, double variance, double degrees) {
      const double model = iteration == 0 ? variance : std::max(v0 + k * x, 1e-6);
      const double w = degrees / (2.0 * model * model);
      sw += w;
      sx += w * x;
      sy += w * variance;
      sxx += w * x * x;
      sxy += w * x * variance;
      const double r = variance - (v0 + k * x);
      chi2 += w * r * r;
    };
    for (const TransferBin* bin : used) {
      add(bin->level() - dark.mean_dn, bin->variance(), bin->degrees);
    }
    if (is_dark_good) {
      add(0.0, dark.variance_dn2, dark.degrees);
    }
    det = sw * sxx - sx * sx;
    if (!(det > 0.0)) {
      return std::nullopt;
    }
    v0 = (sxx * sy - sx * sxy) / det;
    k = (sw * sxy - sx * sy) / det;
  }
  if (!(k > 0.0)) {
    return std::nullopt;
  }
  SensorMeasurement m;
  const auto n_points = static_cast<double>(used.size() + (is_dark_good ? 1U : 0U));
  m.reduced_chi2 = chi2 / (n_points - 2.0);
  const double stretch = std::sqrt(std::max(1.0, m.reduced_chi2));
  const double k_sigma = std::sqrt(sw / det) * stretch;
  const double v0_sigma = std::sqrt(sxx / det) * stretch;
  const auto n = static_cast<std::int64_t>(pairs);
  const double gain = 1.0 / k;
  m.gain_e_per_dn = {gain, gain * k_sigma / k, n};
  m.dark_variance_dn2 = v0;
  m.is_read_from_curve = !is_dark_good;
  const double dark_variance = is_dark_good ? dark.variance_dn2 : v0;
  const double variance_sigma =
      is_dark_good ? dark.variance_dn2 * std::sqrt(2.0 / dark.degrees) : v0_sigma;
  const double read_variance = std::max(0.0, dark_variance - kRounding);
  const double read_dn = std::sqrt(read_variance);
  const double read_dn_sigma =
      read_dn > 0.0 ? variance_sigma / (2.0 * read_dn) : std::sqrt(variance_sigma);
  m.read_e = {gain * read_dn, std::hypot(gain * read_dn_sigma, read_dn * m.gain_e_per_dn.sigma),
              static_cast<std::int64_t>(is_dark_good ? dark.n : pairs)};
  m.black_dn = {dark.mean_dn,
                dark.n > 0.0 ? std::sqrt((dark.variance_dn2 / 2.0 + kRounding) / dark.n) : 0.0,
                static_cast<std::int64_t>(dark.n)};
  if (saturation_dn) {
    const double range = *saturation_dn - dark.mean_dn;
    m.is_converter_limited = *saturation_dn >= white - 0.5;
    m.full_well_e = Measured{gain * range, m.gain_e_per_dn.sigma * range, n};
  }
  m.linearity_percent = linearity(levels, dark.mean_dn);
  return m;
}

}  // namespace haarlight::capture
