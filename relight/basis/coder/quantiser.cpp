// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/coder/quantiser.h"

#include <algorithm>
#include <bit>
#include <numeric>

namespace haarlight::relight {

namespace {

constexpr unsigned kDroppedBits = 17;
constexpr std::size_t kBins = std::size_t{1} << (31 - kDroppedBits);

}  // namespace

MagnitudeHistogram::MagnitudeHistogram() : bins_(kBins) {}

void MagnitudeHistogram::add(double c) {
  const auto bits = std::bit_cast<std::uint32_t>(static_cast<float>(std::abs(c)));
  const std::size_t bin = std::min<std::size_t>(bits >> kDroppedBits, kBins - 1);
  bins_[bin].count += 1.0;
  bins_[bin].energy += c * c;
}

void MagnitudeHistogram::merge(const MagnitudeHistogram& other) {
  for (std::size_t i = 0; i < kBins; ++i) {
    bins_[i].count += other.bins_[i].count;
    bins_[i].energy += other.bins_[i].energy;
  }
}

double MagnitudeHistogram::error_energy(double step) const {
  constexpr double kFine = 16.0;  // above this the error is uniform: step^2 / 12
  double error = 0.0;
  for (std::size_t i = 0; i < kBins; ++i) {
    if (bins_[i].count == 0.0) {
      continue;
    }
    const double v = std::sqrt(bins_[i].energy / bins_[i].count) / step;
    if (v < kDeadZone) {
      error += bins_[i].energy;
    } else if (v < kFine) {
      const double rest = (v - std::round(v)) * step;
      error += bins_[i].count * rest * rest;
    } else {
      error += bins_[i].count * step * step / 12.0;
    }
  }
  return error;
}

double MagnitudeHistogram::choose_step(double allowed, double largest) const {
  double low = largest * 0x1p-48;
  double high = largest * 4.0;
  if (error_energy(high) <= allowed) {
    return high;
  }
  for (int i = 0; i < 60; ++i) {
    const double middle = std::sqrt(low * high);
    (error_energy(middle) <= allowed ? low : high) = middle;
  }
  return low;
}

double MagnitudeHistogram::lower_edge(std::uint32_t bin) {
  return double{std::bit_cast<float>(bin << kDroppedBits)};
}

double MagnitudeHistogram::n_values() const {
  return std::accumulate(bins_.begin(), bins_.end(), 0.0,
                         [](double sum, const Bin& bin) { return sum + bin.count; });
}

double MagnitudeHistogram::n_kept(double step) const {
  double n = 0.0;
  for (std::size_t i = 0; i < kBins; ++i) {
    if (bins_[i].count > 0.0 &&
        std::sqrt(bins_[i].energy / bins_[i].count) >= kDeadZone * step) {
      n += bins_[i].count;
    }
  }
  return n;
}

std::vector<double> MagnitudeHistogram::to_numbers() const {
  std::vector<double> numbers;
  for (std::size_t i = 0; i < kBins; ++i) {
    if (bins_[i].count != 0.0) {
      numbers.insert(numbers.end(), {static_cast<double>(i), bins_[i].count, bins_[i].energy});
    }
  }
  return numbers;
}

bool MagnitudeHistogram::add_numbers(std::span<const double> numbers) {
  if (numbers.size() % 3 != 0) {
    return false;
  }
  for (std::size_t i = 0; i < numbers.size(); i += 3) {
    const double bin = numbers[i];
    if (!(bin >= 0.0 && bin < static_cast<double>(kBins)) || bin != std::floor(bin)) {
      return false;
    }
    bins_[static_cast<std::size_t>(bin)].count += numbers[i + 1];
    bins_[static_cast<std::size_t>(bin)].energy += numbers[i + 2];
  }
  return true;
}

}  // namespace haarlight::relight
