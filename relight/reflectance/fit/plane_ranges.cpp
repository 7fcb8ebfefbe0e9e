// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/plane_ranges.h"

#include <algorithm>
#include <cmath>

namespace haarlight::relight {

namespace {

/// Sums over a histogram's bins [0, i) of 1, x and x^2, x in bins.
struct Moments {
  std::vector<double> n;
  std::vector<double> x;
  std::vector<double> xx;
  explicit Moments(std::span<const std::uint64_t> counts)
      : n(counts.size() + 1), x(counts.size() + 1), xx(counts.size() + 1) {
    for (std::size_t i = 0; i < counts.size(); ++i) {
      const auto at = static_cast<double>(i);
      const auto count = static_cast<double>(counts[i]);
      n[i + 1] = n[i] + count;
      x[i + 1] = x[i] + count * at;
      xx[i + 1] = xx[i] + count * at * at;
    }
  }
  /// Sum of (x - end)^2 over the bins below `end`, and over those above.
  [[nodiscard]] double cut_below(std::size_t end) const {
    const auto e = static_cast<double>(end);
    return xx[end] - 2.0 * e * x[end] + e * e * n[end];
  }
  [[nodiscard]] double cut_above(std::size_t end) const {
    const auto e = static_cast<double>(end);
    const std::size_t i = end + 1;
    return (xx.back() - xx[i]) - 2.0 * e * (x.back() - x[i]) + e * e * (n.back() - n[i]);
  }
  /// Rounding to 255 steps between the ends has errors uniform within half a step.
  [[nodiscard]] double cost(std::size_t low, std::size_t high) const {
    const double step = static_cast<double>(high - low) / 255.0;
    return cut_below(low) + cut_above(high) + n.back() * step * step / 12.0;
  }
};

/// The scale of a .ptm over [a, b]: 0 is exactly the byte `bias`, and the step has the six
/// decimals that the file prints, rounded up.
PlaneScale ptm_scale_over(double a, double b) {
  a = std::min(a, 0.0);
  b = std::max(b, 0.0);
  const double bias = std::clamp(std::round(-255.0 * a / (b - a)), 0.0, 255.0);
  // The step that covers both ends from that byte.
  const double step =
      std::max(bias > 0.0 ? -a / bias : 0.0, bias < 255.0 ? b / (255.0 - bias) : 0.0);
  const double printed = std::ceil(std::max(step * 255.0, 1e-6) * 1e6) / 1e6;
  return {printed / 255.0, -bias * printed / 255.0};
}

}  // namespace

void PlaneHistogram::add(std::span<const std::uint16_t> codes) {
  std::uint32_t* bins = quarters_.data();
  const auto bin_of = [](std::uint16_t code) { return std::size_t{code} >> 4U; };
  std::size_t i = 0;
  for (; i + 4 <= codes.size(); i += 4) {
    ++bins[bin_of(codes[i])];
    ++bins[kBins + bin_of(codes[i + 1])];
    ++bins[2 * kBins + bin_of(codes[i + 2])];
    ++bins[3 * kBins + bin_of(codes[i + 3])];
  }
  for (; i < codes.size(); ++i) {
    ++bins[bin_of(codes[i])];
  }
}

void PlaneHistogram::add(const PlaneHistogram& other) {
  const std::vector<std::uint64_t> more = other.counts();
  for (std::size_t i = 0; i < kBins; ++i) {
    counts_[i] += more[i];
  }
}

std::vector<std::uint64_t> PlaneHistogram::counts() const {
  std::vector<std::uint64_t> sums = counts_;
  for (std::size_t i = 0; i < quarters_.size(); ++i) {
    sums[i % kBins] += quarters_[i];
  }
  return sums;
}

PlaneRange choose_range(const PlaneHistogram& histogram, const PlaneCodes& codes,
                        RangeEnds ends, ScaleRule rule) {
  const auto counts = histogram.counts();
  const auto is_hit = [](std::uint64_t count) { return count > 0; };
  const auto first = std::find_if(counts.begin(), counts.end(), is_hit);
  if (first == counts.end()) {
    return {};
  }
  auto low = static_cast<std::size_t>(first - counts.begin());
  auto high = counts.size() - 1;
  while (counts[high] == 0) {
    --high;
  }
  const Moments moments(counts);
  if (ends == RangeEnds::least_error) {
    const std::size_t least = low;
    const std::size_t most = high;
    // One end at a time: either step lowers the cost, and it converges in three rounds.
    for (int round = 0; round < 3; ++round) {
      std::size_t best = low;
      for (std::size_t i = least; i < high; ++i) {
        best = moments.cost(i, high) < moments.cost(best, high) ? i : best;
      }
      low = best;
      best = high;
      for (std::size_t i = most; i > low; --i) {
        best = moments.cost(low, i) < moments.cost(low, best) ? i : best;
      }
      high = best;
    }
  }
  // A bin's sixteen codes: its lower edge and its upper edge.
  double a = codes.low + codes.step * 16.0 * static_cast<double>(low);
  double b = codes.low + codes.step * (16.0 * static_cast<double>(high) + 15.0);
  PlaneRange range;
  range.clipped = (moments.n[low] + moments.n.back() - moments.n[high + 1]) / moments.n.back();
  range.rms_error = 16.0 * codes.step * std::sqrt(moments.cost(low, high) / moments.n.back());
  if (rule == ScaleRule::ptm) {
    range.scale = ptm_scale_over(a, b);
  } else if (rule == ScaleRule::rti) {
    const auto span = static_cast<float>(b - a);
    range.scale = {static_cast<double>(span) / 255.0,
                   static_cast<double>(static_cast<float>(a))};
  } else {
    range.scale = {(b - a) / 255.0, a};
  }
  return range;
}

}  // namespace haarlight::relight
