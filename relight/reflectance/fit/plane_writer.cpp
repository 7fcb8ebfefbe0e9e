// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/plane_writer.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/reflectance/fit/wide_vectors.h"

namespace haarlight::relight {

namespace {

constexpr std::size_t kPixels = 64;    // converted at a time
constexpr std::size_t kBandRows = 16;  // read back at a time

HAARLIGHT_WIDER void bytes_of(const std::uint16_t* __restrict codes, std::size_t n,
                              float factor, float shift, std::uint8_t* __restrict bytes) {
  for (std::size_t x = 0; x < n; ++x) {
    const float value = factor * static_cast<float>(codes[x]) + shift;
    const float most = value < 255.0F ? value : 255.0F;
    bytes[x] = static_cast<std::uint8_t>(static_cast<int>(most > 0.0F ? most : 0.0F));
  }
}

HAARLIGHT_WIDER void codes_of(const float* __restrict values, std::size_t n, float scale,
                              float shift, std::uint16_t* __restrict codes) {
  for (std::size_t x = 0; x < n; ++x) {
    const float value = values[x] * scale + shift;
    const float most = value < 65535.0F ? value : 65535.0F;
    codes[x] = static_cast<std::uint16_t>(static_cast<int>(most > 0.0F ? most : 0.0F));
  }
}

/// What encodes a plane's values: code = value * scale + shift, clipped.
struct Encoding {
  float scale = 1.0F;
  float shift = 0.0F;
  Encoding(const PlaneCodes& codes, double added)
      : scale(static_cast<float>(1.0 / codes.step)),
        shift(static_cast<float>(0.5 + (added - codes.low) / codes.step)) {}
};

/// 16-bit codes to the planes' bytes.
class ByteRows {
 public:
  ByteRows(const std::vector<PlaneCodes>& codes, const std::vector<PlaneScale>& scales) {
    for (std::size_t p = 0; p < codes.size(); ++p) {
      factor_.push_back(static_cast<float>(codes[p].step / scales[p].scale));
      shift_.push_back(
          static_cast<float>((codes[p].low - scales[p].offset) / scales[p].scale + 0.5));
    }
  }
  /// @param line  (n_planes, width)
  /// @param out   (width, n_planes)
  void convert(const std::uint16_t* line, std::size_t width, std::uint8_t* out) const {
    const std::size_t n_planes = factor_.size();
    std::array<std::uint8_t, kPixels> bytes{};
    for (std::size_t x0 = 0; x0 < width; x0 += kPixels) {
      const std::size_t n = std::min(kPixels, width - x0);
      for (std::size_t p = 0; p < n_planes; ++p) {
        bytes_of(line + p * width + x0, n, factor_[p], shift_[p], bytes.data());
        std::uint8_t* to = out + x0 * n_planes + p;
        for (std::size_t x = 0; x < n; ++x, to += n_planes) {
          *to = bytes[x];
        }
      }
    }
  }

 private:
  std::vector<float> factor_;
  std::vector<float> shift_;
};

/// Whether two planes must have one range: a term's planes of R, G and B in .ptm and .rti.
bool share_range(const ReflectanceModel& model, ScaleRule rule, std::size_t p, std::size_t q) {
  const auto n_terms = static_cast<std::size_t>(model.n_terms);
  const bool is_shared = rule != ScaleRule::any && model.colour == ReflectanceColour::rgb;
  return is_shared ? p % n_terms == q % n_terms : p == q;
}

}  // namespace

PlaneWriter::PlaneWriter(int width, int height, std::vector<PlaneCodes> codes,
                         const PlaneOptions& options)
    : width_(static_cast<std::size_t>(width)),
      height_(static_cast<std::size_t>(height)),
      codes_(std::move(codes)),
      options_(options),
      store_(std::uint64_t{codes_.size()} * width_ * height_, options.memory_bytes,
             options.work_folder),
      histograms_(codes_.size()) {}

void PlaneWriter::encode(std::size_t plane, std::span<const float> values, double added,
                         std::uint16_t* codes) const {
  const Encoding encoding(codes_[plane], added);
  codes_of(values.data(), values.size(), encoding.scale, encoding.shift, codes);
}

void PlaneWriter::encode_threes(std::size_t plane, std::size_t apart,
                                std::span<const float> values, double added,
                                std::uint16_t* codes) const {
  const Encoding encoding(codes_[plane], added);
  std::array<std::uint16_t, 3 * kPixels> threes{};
  for (std::size_t i = 0; i < values.size(); i += threes.size()) {
    const std::size_t n = std::min(threes.size(), values.size() - i);
    codes_of(values.data() + i, n, encoding.scale, encoding.shift, threes.data());
    for (std::size_t c = 0; c < 3; ++c) {
      std::uint16_t* to = codes + c * apart * width_ + i / 3;
      for (std::size_t x = 0; x < n / 3; ++x) {
        to[x] = threes[3 * x + c];
      }
    }
  }
}

std::span<std::uint16_t> PlaneWriter::next_rows(std::size_t n_rows) {
  rows_ = store_.room(n_rows * n_planes() * width_);
  return rows_;
}

void PlaneWriter::append() {
  const std::span<const std::uint16_t> lines = rows_;
  const std::size_t n_rows = lines.size() / (n_planes() * width_);
  parallel_for(n_planes(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t p = begin; p < end; ++p) {
      for (std::size_t y = 0; y < n_rows; ++y) {
        histograms_[p].add(lines.subspan((y * n_planes() + p) * width_, width_));
      }
    }
  });
  store_.keep();
  rows_ = {};
}

FitResult PlaneWriter::finish(ReflectanceModel model) {
  HAARLIGHT_EXPECTS(n_planes_of(model.colour, model.n_terms) == static_cast<int>(n_planes()),
                    "the planes of this model");
  FitResult result;
  result.model = std::move(model);
  double error = 0.0;
  for (std::size_t p = 0; p < n_planes(); ++p) {
    PlaneHistogram shared;
    for (std::size_t q = 0; q < n_planes(); ++q) {
      if (share_range(result.model, options_.rule, p, q)) {
        shared.add(histograms_[q]);
      }
    }
    PlaneRange range = choose_range(shared, codes_[p], options_.ends, options_.rule);
    if (result.model.colour == ReflectanceColour::lrgb &&
        p >= static_cast<std::size_t>(result.model.n_terms)) {
      range = {};  // in every format the bytes are the colour itself
      range.rms_error = range.scale.scale / std::sqrt(12.0);
    }
    result.model.scales.push_back(range.scale);
    error += range.rms_error * range.rms_error;
    result.clipped += range.clipped / static_cast<double>(n_planes());
  }
  result.quantisation_rms = std::sqrt(error / static_cast<double>(n_planes()));
  const ByteRows bytes(codes_, result.model.scales);
  Image<std::uint8_t> planes(static_cast<int>(height_), static_cast<int>(width_),
                             static_cast<int>(n_planes()));
  for (std::size_t y0 = 0; y0 < height_; y0 += kBandRows) {
    const std::size_t n_rows = std::min(kBandRows, height_ - y0);
    const std::span<const std::uint16_t> lines = store_.next(n_rows * n_planes() * width_);
    parallel_for(n_rows, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t y = begin; y < end; ++y) {
        bytes.convert(&lines[y * n_planes() * width_], width_,
                      planes.view().row(static_cast<int>(y0 + y)).data());
      }
    });
  }
  result.model.planes = std::move(planes);
  return result;
}

}  // namespace haarlight::relight
