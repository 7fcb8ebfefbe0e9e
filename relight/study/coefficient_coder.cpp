// SPDX-License-Identifier: Apache-2.0
#include "relight/study/coefficient_coder.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numeric>

#include <zstd.h>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/basis/half_float.h"

namespace haarlight::relight {

namespace {

constexpr int kZstdLevel = 9;          // used for the published figures
constexpr std::size_t kBlock = 64;     // coefficients packed together
constexpr std::size_t kPixels = 1024;  // per piece of work

struct ContextFree {
  void operator()(ZSTD_CCtx* context) const noexcept { ZSTD_freeCCtx(context); }
};

std::uint64_t zstd_bytes(std::span<const std::uint8_t> raw) {
  if (std::all_of(raw.begin(), raw.end(), [](std::uint8_t v) { return v == 0; })) {
    return 0;  // an empty block of the index
  }
  const std::unique_ptr<ZSTD_CCtx, ContextFree> context(ZSTD_createCCtx());
  HAARLIGHT_EXPECTS(context != nullptr, "zstd: no memory");
  std::vector<std::uint8_t> packed(ZSTD_compressBound(raw.size()));
  const std::size_t size = ZSTD_compressCCtx(context.get(), packed.data(), packed.size(),
                                             raw.data(), raw.size(), kZstdLevel);
  HAARLIGHT_EXPECTS(ZSTD_isError(size) == 0, "zstd: compression failed");
  return size;
}

int half_exponent(std::span<const float> values) {
  constexpr int kLargest = 15;  // magnitudes below 2^15: well below 65504, rounding included
  float largest = 0.0F;
  for (const float value : values) {
    largest = std::max(largest, std::abs(value));
  }
  int exponent = 0;
  (void)std::frexp(largest, &exponent);
  return exponent - kLargest;
}

/// Runs `keep` over the kept values; it returns the new value.
template <class Keep>
std::uint64_t keep_values(std::span<float> values, std::size_t n_coefficients,
                          std::size_t n_kept, Keep keep) {
  HAARLIGHT_EXPECTS(n_kept <= n_coefficients && values.size() % n_coefficients == 0,
                    "whole pixels");
  const std::size_t n_pixels = values.size() / n_coefficients;
  std::vector<std::uint64_t> counts((n_pixels + kPixels - 1) / kPixels);
  parallel_for(n_pixels, kPixels, [&](std::size_t begin, std::size_t end) {
    for (std::size_t first = begin; first < end; first += kPixels) {
      std::uint64_t n = 0;
      for (std::size_t p = first; p < std::min(end, first + kPixels); ++p) {
        float* row = values.data() + p * n_coefficients;
        for (std::size_t i = 0; i < n_kept; ++i) {
          row[i] = keep(row[i]);
          n += row[i] != 0.0F ? 1 : 0;
        }
        std::fill(row + n_kept, row + n_coefficients, 0.0F);
      }
      counts[first / kPixels] = n;
    }
  });
  return std::accumulate(counts.begin(), counts.end(), std::uint64_t{0});
}

}  // namespace

std::uint64_t quantise_values(std::span<float> values, std::size_t n_coefficients,
                              std::size_t n_kept, float step) {
  HAARLIGHT_EXPECTS(step > 0.0F, "a step");
  const float inverse = 1.0F / step;
  return keep_values(values, n_coefficients, n_kept,
                     [=](float c) { return static_cast<float>(quantise(c, inverse)) * step; });
}

std::uint64_t threshold_values(std::span<float> values, std::size_t n_coefficients,
                               std::size_t n_kept, float threshold) {
  return keep_values(values, n_coefficients, n_kept,
                     [=](float c) { return std::abs(c) >= threshold ? c : 0.0F; });
}

std::uint64_t packed_bytes(std::span<const float> values, std::size_t n_coefficients,
                           std::size_t n_kept, float step, std::span<const int> pixel_order) {
  const std::size_t n_pixels = values.size() / n_coefficients;
  HAARLIGHT_EXPECTS(pixel_order.empty() || pixel_order.size() == n_pixels, "every pixel once");
  if (n_kept == 0) {
    return 0;
  }
  const std::size_t n_blocks = (n_kept + kBlock - 1) / kBlock;
  std::vector<std::uint64_t> bytes(n_blocks);
  const float inverse = 1.0F / step;
  parallel_for(n_blocks, 1, [&](std::size_t begin, std::size_t end) {
    std::vector<std::int32_t> planes;
    std::vector<std::uint8_t> raw;
    for (std::size_t block = begin; block < end; ++block) {
      const std::size_t first = block * kBlock;
      const std::size_t n = std::min(kBlock, n_kept - first);
      planes.resize(n * n_pixels);
      std::int32_t largest = 0;
      for (std::size_t p = 0; p < n_pixels; ++p) {
        const std::size_t pixel =
            pixel_order.empty() ? p : static_cast<std::size_t>(pixel_order[p]);
        const float* row = values.data() + pixel * n_coefficients + first;
        for (std::size_t i = 0; i < n; ++i) {
          const auto v = static_cast<std::int32_t>(std::lround(row[i] * inverse));
          planes[i * n_pixels + p] = v;
          largest = std::max(largest, std::abs(v));
        }
      }
      const std::size_t width = largest <= 32767 ? 2 : 4;
      raw.resize(width * planes.size());
      for (std::size_t byte = 0; byte < width; ++byte) {
        std::uint8_t* to = raw.data() + byte * planes.size();
        for (std::size_t i = 0; i < planes.size(); ++i) {
          to[i] =
              static_cast<std::uint8_t>(static_cast<std::uint32_t>(planes[i]) >> (8 * byte));
        }
      }
      bytes[block] = zstd_bytes(raw);
    }
  });
  return std::accumulate(bytes.begin(), bytes.end(), std::uint64_t{0});
}

void round_to_halves(std::span<float> values) {
  const int exponent = half_exponent(values);
  for (float& value : values) {
    value = std::ldexp(half_to_float(float_to_half(std::ldexp(value, -exponent))), exponent);
  }
}

std::uint64_t packed_half_bytes(std::span<const float> values) {
  const int exponent = half_exponent(values);
  std::vector<std::uint8_t> raw(2 * values.size());
  for (std::size_t i = 0; i < values.size(); ++i) {
    const std::uint16_t half = float_to_half(std::ldexp(values[i], -exponent));
    raw[i] = static_cast<std::uint8_t>(half & 0xffU);
    raw[values.size() + i] = static_cast<std::uint8_t>(half >> 8U);
  }
  return zstd_bytes(raw) + 2;
}

CoefficientCurve::CoefficientCurve(const MagnitudeHistogram& histogram) {
  const std::vector<double> numbers = histogram.to_numbers();
  for (std::size_t i = 0; i + 2 < numbers.size(); i += 3) {
    if (numbers[i + 2] > 0.0) {
      const auto bin = static_cast<std::uint32_t>(numbers[i]);
      bins_.push_back({MagnitudeHistogram::lower_edge(bin),
                       MagnitudeHistogram::lower_edge(bin + 1), numbers[i + 1],
                       numbers[i + 2]});
      energy_ += numbers[i + 2];
    }
  }
}

double CoefficientCurve::threshold_for_energy(double allowed) const {
  double energy = 0.0;
  for (const Bin& bin : bins_) {
    if (energy + bin.energy > allowed) {
      return bin.lower + (bin.upper - bin.lower) * (allowed - energy) / bin.energy;
    }
    energy += bin.energy;
  }
  return 2.0 * largest();
}

double CoefficientCurve::threshold_for_count(double n) const {
  double above = std::accumulate(bins_.begin(), bins_.end(), 0.0,
                                 [](double sum, const Bin& bin) { return sum + bin.count; });
  if (above <= n) {
    return 0.0;
  }
  for (const Bin& bin : bins_) {
    above -= bin.count;
    if (above <= n) {
      return bin.upper - (bin.upper - bin.lower) * (n - above) / bin.count;
    }
  }
  return largest();
}

double CoefficientCurve::count_from(double threshold) const {
  double n = 0.0;
  for (const Bin& bin : bins_) {
    n += bin.count * std::clamp((bin.upper - threshold) / (bin.upper - bin.lower), 0.0, 1.0);
  }
  return n;
}

double CoefficientCurve::largest() const noexcept {
  return bins_.empty() ? 0.0 : bins_.back().upper;
}

}  // namespace haarlight::relight
