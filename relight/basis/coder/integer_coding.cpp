// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/coder/integer_coding.h"

#include <algorithm>
#include <cmath>

#include "relight/basis/plate/tile_plate.h"

namespace haarlight::relight {

IntegerPrediction::IntegerPrediction(const BasisHeader& header, std::span<const float> vectors,
                                     const TileRect& rect, std::span<const float> tile_plate)
    : header_(header),
      vectors_(vectors),
      tile_plate_(tile_plate),
      direction_(static_cast<std::size_t>(header.dims.n_lights)),
      predicted_(direction_.size()) {
  if (header.plate_rank > 0) {
    terms_ = plate_terms(rect, header.plate_degree);
    n_terms_ = terms_.size() / static_cast<std::size_t>(rect.n_pixels());
  }
}

std::span<const std::int32_t> IntegerPrediction::of(std::size_t pixel, std::int32_t gain) {
  if (gain == 0 || header_.plate_rank == 0) {
    std::fill(predicted_.begin(), predicted_.end(), 0);
    return predicted_;
  }
  plate_direction<double>(tile_plate_, std::span(terms_).subspan(pixel * n_terms_, n_terms_),
                          vectors_, direction_);
  const double length = header_.gain_step * gain;
  for (std::size_t k = 0; k < predicted_.size(); ++k) {
    const double whole = std::floor(length * direction_[k] / header_.units[k] + 0.5);
    constexpr double kMost = kLargestInteger;
    predicted_[k] = static_cast<std::int32_t>(std::clamp(whole, -kMost, kMost));
  }
  return predicted_;
}

}  // namespace haarlight::relight
