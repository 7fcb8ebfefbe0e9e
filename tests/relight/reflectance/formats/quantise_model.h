// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "haarlight/core/error.h"
#include "haarlight/core/image.h"
#include "haarlight/relight/reflectance/formats/quantise.h"

/// @file
/// A whole model's coefficients in memory to bytes, as `fit` does row by row, and what that
/// loses.

namespace haarlight::relight {

/// The loss of bytes against the values they represent, plane by plane.
class QuantisationLoss {
 public:
  explicit QuantisationLoss(int n_planes) : squares_(static_cast<std::size_t>(n_planes)) {}
  void add(std::span<const float> samples, std::span<const PlaneScale> scales,
           std::span<const std::uint8_t> bytes);
  void merge(const QuantisationLoss& other);
  /// Root mean square error of a plane, in its values' unit; 0 without samples.
  [[nodiscard]] double rms(int plane) const noexcept;
  /// The largest error of any plane in its own steps: 0.5 where nothing is clipped.
  [[nodiscard]] double worst_steps() const noexcept { return worst_steps_; }

 private:
  std::vector<double> squares_;
  std::uint64_t n_pixels_ = 0;
  double worst_steps_ = 0.0;
};

/// Fills a model's planes and scales from coefficients in memory; its basis, colour, terms and
/// the rest are set already.
/// @param coefficients  (height, width, n_planes)
/// @throws Error  a value is not a finite number
QuantisationLoss quantise(ReflectanceModel& model, ImageView<const float> coefficients,
                          ScaleRule rule = ScaleRule::any);

inline void QuantisationLoss::add(std::span<const float> samples,
                                  std::span<const PlaneScale> scales,
                                  std::span<const std::uint8_t> bytes) {
  HAARLIGHT_EXPECTS(samples.size() == bytes.size() && scales.size() == squares_.size(),
                    "as many values");
  for (std::size_t i = 0; i < samples.size(); i += scales.size()) {
    for (std::size_t p = 0; p < scales.size(); ++p) {
      const double error = std::abs(static_cast<double>(samples[i + p]) -
                                    (bytes[i + p] * scales[p].scale + scales[p].offset));
      squares_[p] += error * error;
      if (scales[p].scale != 0.0) {
        worst_steps_ = std::max(worst_steps_, error / std::abs(scales[p].scale));
      }
    }
  }
  n_pixels_ += samples.size() / scales.size();
}

inline void QuantisationLoss::merge(const QuantisationLoss& other) {
  HAARLIGHT_EXPECTS(other.squares_.size() == squares_.size(), "as many planes");
  for (std::size_t p = 0; p < squares_.size(); ++p) {
    squares_[p] += other.squares_[p];
  }
  n_pixels_ += other.n_pixels_;
  worst_steps_ = std::max(worst_steps_, other.worst_steps_);
}

inline double QuantisationLoss::rms(int plane) const noexcept {
  return n_pixels_ == 0 ? 0.0
                        : std::sqrt(squares_[static_cast<std::size_t>(plane)] /
                                    static_cast<double>(n_pixels_));
}

inline QuantisationLoss quantise(ReflectanceModel& model, ImageView<const float> coefficients,
                                 ScaleRule rule) {
  PlaneRanges ranges(coefficients.channels());
  for (int y = 0; y < coefficients.height(); ++y) {
    ranges.add(coefficients.row(y));
  }
  model.scales = choose_scales(ranges, model.colour, model.n_terms, rule);
  model.planes =
      Image<std::uint8_t>(coefficients.height(), coefficients.width(), coefficients.channels());
  QuantisationLoss loss(coefficients.channels());
  for (int y = 0; y < coefficients.height(); ++y) {
    quantise_row(coefficients.row(y), model.scales, model.planes.view().row(y));
    loss.add(coefficients.row(y), model.scales, model.planes.view().row(y));
  }
  return loss;
}

}  // namespace haarlight::relight
