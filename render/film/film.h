// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/image.h"

/// @file
/// What has been seen of a picture so far: per pixel the sums of its samples and of their
/// squares, in double precision. A sample belongs to the pixel that it was drawn for (a box
/// filter), so that tiles never meet; within a pixel samples are added in their order.

namespace haarlight::render {

/// How far a picture's mean may be off, from the samples alone.
struct FilmError {
  /// sqrt(sum of the squared standard errors) / ||picture||, over all pixels and colours. The
  /// noise's own part of the means' squares is taken off: it would make a picture of noise look
  /// known. Infinite where that leaves nothing, while a pixel has fewer than two samples, and
  /// where no sample has found light yet.
  double relative_l2 = 0.0;
  bool is_black = false;  ///< no sample has found light
};

class Film {
 public:
  Film(int width, int height);

  [[nodiscard]] int width() const noexcept { return width_; }
  [[nodiscard]] int height() const noexcept { return height_; }

  /// From one thread per pixel. @param radiance  RGB, finite
  void add(int x, int y, const Eigen::Vector3d& radiance);

  [[nodiscard]] Image<float> mean() const;
  /// Of the mean: sqrt(variance of the samples / their number). Samples that are spread evenly
  /// (Sobol's) make a smaller error than independent ones: this is then usually too large.
  [[nodiscard]] Image<float> standard_error() const;
  [[nodiscard]] FilmError error() const;

 private:
  struct Pixel {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    Eigen::Vector3d sum_of_squares = Eigen::Vector3d::Zero();
    std::uint32_t n = 0;
  };
  [[nodiscard]] static Eigen::Vector3d squared_error(const Pixel& pixel);

  int width_;
  int height_;
  std::vector<Pixel> pixels_;
};

}  // namespace haarlight::render
