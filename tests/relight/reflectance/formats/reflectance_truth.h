// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/image.h"
#include "haarlight/relight/reflectance/formats/reflectance.h"

/// @file
/// What the tests of relight/formats share: small models, directions, PSNR.

namespace haarlight::testing {

/// Peak signal-to-noise ratio of 8-bit pictures in dB, peak 1: values are clipped to 0..1 and
/// rounded to bytes before, as a viewer shows them.
inline double psnr_db(ImageView<const float> found, ImageView<const float> truth) {
  const auto byte = [](float value) {
    return std::round(255.0 * std::min(std::max(static_cast<double>(value), 0.0), 1.0));
  };
  double squares = 0.0;
  double n = 0.0;
  for (int y = 0; y < truth.height(); ++y) {
    for (std::size_t i = 0; i < truth.row(y).size(); ++i) {
      const double difference = byte(found.row(y)[i]) - byte(truth.row(y)[i]);
      squares += difference * difference;
      n += 1.0;
    }
  }
  return squares == 0.0 ? 200.0 : 10.0 * std::log10(255.0 * 255.0 * n / squares);
}

/// Unit directions spread over the hemisphere down to `lowest` in z.
inline std::vector<Eigen::Vector3d> spread_directions(int n, double lowest = 0.2) {
  std::vector<Eigen::Vector3d> directions;
  for (int i = 0; i < n; ++i) {
    const double z = lowest + (1.0 - lowest) * (i + 0.5) / n;
    const double azimuth = i * std::numbers::pi * (3.0 - std::sqrt(5.0));
    const double rho = std::sqrt(1.0 - z * z);
    directions.emplace_back(rho * std::cos(azimuth), rho * std::sin(azimuth), z);
  }
  return directions;
}

/// Smooth coefficients, different in every plane, that light up to about white.
inline Image<float> smooth_coefficients(int height, int width, int n_planes) {
  Image<float> coefficients(height, width, n_planes);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int p = 0; p < n_planes; ++p) {
        coefficients(y, x, p) =
            static_cast<float>(0.25 + 0.2 * std::sin(0.3 * (p + 1) + 5.0 * x / width) *
                                          std::cos(0.7 * p + 4.0 * y / height));
      }
    }
  }
  return coefficients;
}

inline relight::ReflectanceModel empty_model(relight::ReflectanceBasis basis,
                                             relight::ReflectanceColour colour, int n_terms) {
  relight::ReflectanceModel model;
  model.basis = basis;
  model.colour = colour;
  model.n_terms = n_terms;
  return model;
}

}  // namespace haarlight::testing
