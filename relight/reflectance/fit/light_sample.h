// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

#include <Eigen/Core>

#include "relight/reflectance/fit/picture_rows.h"

/// @file
/// Some pixels of a capture under all its lights: the data for choosing a fit.

namespace haarlight::relight {

struct LightSample {
  /// (3 * n_lights, n_pixels), 0..1, light by light R, G, B.
  Eigen::MatrixXf values;
  [[nodiscard]] Eigen::Index n_lights() const { return values.rows() / 3; }
  /// (n_lights, n_lights): mean of products of two lights' values, over pixels and channels.
  [[nodiscard]] Eigen::MatrixXd products() const;
};

inline constexpr std::size_t kSamplePixels = 40000;

/// Pixels of rows spread evenly over the picture; fewer if there are many lights (64 MiB).
[[nodiscard]] LightSample sample_lights(PictureRows& rows,
                                        std::size_t n_pixels = kSamplePixels);

}  // namespace haarlight::relight
