// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/fit_check.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

/// Rows [y0, y0 + n) of a model as a model of their own.
ReflectanceModel cut_rows(const ReflectanceModel& model, int y0, int n) {
  ReflectanceModel part = model;
  part.planes = Image<std::uint8_t>(n, model.planes.width(), model.planes.channels());
  for (int y = 0; y < n; ++y) {
    const auto from = model.planes.view().row(y0 + y);
    std::copy(from.begin(), from.end(), part.planes.view().row(y).begin());
  }
  return part;
}

/// In bytes: as shown on the screen.
double square_error(const Image<float>& found, std::span<const std::uint16_t> truth,
                    std::size_t n_lights, std::size_t light) {
  const std::size_t n_row = static_cast<std::size_t>(found.width()) * 3;
  std::uint64_t sum = 0;
  for (int y = 0; y < found.height(); ++y) {
    const auto row = found.view().row(y);
    const std::uint16_t* at = &truth[(static_cast<std::size_t>(y) * n_lights + light) * n_row];
    for (std::size_t i = 0; i < n_row; ++i) {
      const auto byte = static_cast<int>(std::lround(std::clamp(row[i], 0.0F, 1.0F) * 255.0F));
      const int difference = byte - (at[i] + 128) / 257;
      sum += static_cast<std::uint64_t>(difference * difference);
    }
  }
  return static_cast<double>(sum);
}

}  // namespace

double FitError::mean_psnr_db() const {
  return std::accumulate(psnr_db.begin(), psnr_db.end(), 0.0) /
         static_cast<double>(psnr_db.size());
}

FitError measure_fit(const ReflectanceModel& model, PictureRows& rows,
                     const std::vector<Eigen::Vector3d>& directions, std::uint64_t most) {
  const StackDims shape = rows.dims();
  HAARLIGHT_EXPECTS(shape.n_lights == static_cast<int>(directions.size()) &&
                        model.planes.width() == shape.width &&
                        model.planes.height() == shape.height,
                    "the model's own capture");
  const std::size_t n_lights = directions.size();
  const std::size_t n_row = static_cast<std::size_t>(shape.width) * 3;
  constexpr int kBandRows = 16;
  const std::uint64_t n_all = static_cast<std::uint64_t>(shape.height) *
                              static_cast<std::uint64_t>(shape.width) * n_lights;
  const auto n_apart = static_cast<int>(std::min<std::uint64_t>(
      (n_all - 1) / most + 1, static_cast<std::uint64_t>(shape.height / kBandRows + 1)));
  std::vector<std::uint16_t> band(kBandRows * n_lights * n_row);
  std::vector<double> sums(n_lights);
  rows.rewind();
  int n_rows = 0;
  for (int y0 = 0; y0 < shape.height; y0 += kBandRows * n_apart) {
    const int n = std::min(kBandRows, shape.height - y0);
    n_rows += n;
    const auto values = std::span(band).first(static_cast<std::size_t>(n) * n_lights * n_row);
    rows.read(n, values);
    const ReflectanceModel part = cut_rows(model, y0, n);
    for (std::size_t k = 0; k < n_lights; ++k) {
      sums[k] += square_error(relit(part, directions[k]), values, n_lights, k);
    }
    const int left = shape.height - y0 - n;
    if (n_apart > 1 && left > 0) {
      rows.skip(std::min(left, kBandRows * (n_apart - 1)));
    }
  }
  FitError error;
  const double n_values = static_cast<double>(n_rows) * static_cast<double>(n_row);
  for (const double sum : sums) {
    // An exact picture counts as having a single value off by one.
    error.psnr_db.push_back(10.0 * std::log10(255.0 * 255.0 * n_values / std::max(sum, 1.0)));
  }
  return error;
}

}  // namespace haarlight::relight
