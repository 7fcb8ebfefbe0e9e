// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/light_sample.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace haarlight::relight {

Eigen::MatrixXd LightSample::products() const {
  using Eigen::Index;
  const Index n = n_lights();
  Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(n, n);
  constexpr Index kChunk = 2048;  // float sums of this many, then double
  Eigen::MatrixXf chunk(n, kChunk);
  for (Index from = 0; from < values.cols(); from += kChunk) {
    const Index m = std::min(kChunk, values.cols() - from);
    for (Index c = 0; c < 3; ++c) {
      for (Index k = 0; k < n; ++k) {
        chunk.row(k).head(m) = values.row(3 * k + c).segment(from, m);
      }
      const Eigen::MatrixXf part = chunk.leftCols(m) * chunk.leftCols(m).transpose();
      sum += part.cast<double>();
    }
  }
  return sum / (3.0 * static_cast<double>(values.cols()));
}

LightSample sample_lights(PictureRows& rows, std::size_t n_pixels) {
  const StackDims shape = rows.dims();
  const auto width = static_cast<std::size_t>(shape.width);
  const auto height = static_cast<std::size_t>(shape.height);
  const auto n_lights = static_cast<std::size_t>(shape.n_lights);
  constexpr std::size_t kBytes = std::size_t{64} << 20U;
  n_pixels = std::clamp<std::size_t>(n_pixels, 1, kBytes / (3 * n_lights * sizeof(float)));
  // As many rows as columns, as far as the picture allows.
  const auto side = static_cast<std::size_t>(std::ceil(std::sqrt(n_pixels)));
  const std::size_t n_cols =
      std::min(width, std::max<std::size_t>(side, n_pixels / std::min(height, side)));
  const std::size_t n_rows = std::min(height, std::max<std::size_t>(1, n_pixels / n_cols));
  LightSample sample;
  sample.values.resize(static_cast<Eigen::Index>(3 * n_lights),
                       static_cast<Eigen::Index>(n_rows * n_cols));
  std::vector<std::uint16_t> row(width * 3 * n_lights);
  rows.rewind();
  std::size_t y = 0;
  for (std::size_t i = 0; i < n_rows; ++i) {
    const std::size_t at = (2 * i + 1) * height / (2 * n_rows);
    if (at > y) {
      rows.skip(static_cast<int>(at - y));
    }
    rows.read(1, row);
    y = at + 1;
    for (std::size_t j = 0; j < n_cols; ++j) {
      // Shifted by one column per row: no aliasing with regular structure in the picture.
      const std::size_t x = ((2 * j + 1) * width / (2 * n_cols) + i) % width;
      float* to = sample.values.data() + (i * n_cols + j) * 3 * n_lights;
      for (std::size_t k = 0; k < n_lights; ++k) {
        for (std::size_t c = 0; c < 3; ++c) {
          to[3 * k + c] = static_cast<float>(row[(k * width + x) * 3 + c]) / 65535.0F;
        }
      }
    }
  }
  return sample;
}

}  // namespace haarlight::relight
