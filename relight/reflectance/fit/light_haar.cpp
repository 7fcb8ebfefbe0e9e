// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/light_haar.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include "haarlight/core/error.h"

namespace haarlight::relight {

// The transform is orthonormal: the energy dropped is the squared error, but its distribution
// over the lights is known only after inverting.
HaarSize measure_light_haar(const LightSample& sample, const HaarGrid& grid, int n_kept) {
  const auto n_lights = static_cast<std::size_t>(sample.n_lights());
  HAARLIGHT_EXPECTS(grid.is_valid() && n_lights % static_cast<std::size_t>(grid.size()) == 0,
                    "whole grids of lights");
  std::vector<double> squares(n_lights);
  std::vector<float> values(3 * n_lights);  // channel by channel, grid by grid
  std::vector<float> sizes(values.size());
  for (Eigen::Index j = 0; j < sample.values.cols(); ++j) {
    for (std::size_t k = 0; k < n_lights; ++k) {
      for (std::size_t c = 0; c < 3; ++c) {
        values[c * n_lights + k] = sample.values(static_cast<Eigen::Index>(3 * k + c), j);
      }
    }
    haar_forward(std::span(values), grid);
    std::transform(values.begin(), values.end(), sizes.begin(),
                   [](float value) { return std::abs(value); });
    if (static_cast<std::size_t>(n_kept) < values.size()) {
      const auto position = sizes.begin() + n_kept;
      std::nth_element(sizes.begin(), position, sizes.end(), std::greater<>());
      const float threshold = *position;
      for (float& value : values) {
        value = std::abs(value) > threshold ? value : 0.0F;
      }
    }
    haar_inverse(std::span(values), grid);
    for (std::size_t k = 0; k < n_lights; ++k) {
      for (std::size_t c = 0; c < 3; ++c) {
        const auto error = static_cast<double>(
            values[c * n_lights + k] - sample.values(static_cast<Eigen::Index>(3 * k + c), j));
        squares[k] += error * error;
      }
    }
  }
  HaarSize size;
  for (const double square : squares) {
    const double mean = square / (3.0 * static_cast<double>(sample.values.cols()));
    size.psnr_db -= 10.0 * std::log10(std::max(mean, 1e-10)) / static_cast<double>(n_lights);
  }
  size.bytes_per_pixel = 3.0 * std::min<double>(n_kept, static_cast<double>(values.size()));
  return size;
}

}  // namespace haarlight::relight
