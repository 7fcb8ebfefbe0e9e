// SPDX-License-Identifier: Apache-2.0
#include "render/film/film.h"

#include <cmath>
#include <limits>

#include "haarlight/core/error.h"

namespace haarlight::render {

using Eigen::Vector3d;

Film::Film(int width, int height) : width_(width), height_(height) {
  HAARLIGHT_EXPECTS(width > 0 && height > 0, "a picture with pixels");
  pixels_.resize(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
}

void Film::add(int x, int y, const Vector3d& radiance) {
  HAARLIGHT_ASSERT(x >= 0 && x < width_ && y >= 0 && y < height_ && radiance.allFinite());
  Pixel& pixel = pixels_[static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) +
                         static_cast<std::size_t>(x)];
  pixel.sum += radiance;
  pixel.sum_of_squares += radiance.cwiseAbs2();
  ++pixel.n;
}

Vector3d Film::squared_error(const Pixel& pixel) {
  if (pixel.n < 2) {
    return Vector3d::Constant(std::numeric_limits<double>::infinity());
  }
  const double n = pixel.n;
  const Vector3d mean = pixel.sum / n;
  // Rounding may leave a little less than nothing where all samples are equal.
  const Vector3d variance = (pixel.sum_of_squares / n - mean.cwiseAbs2()).cwiseMax(0.0);
  return variance / (n - 1.0);
}

Image<float> Film::mean() const {
  Image<float> picture(height_, width_, 3);
  for (std::size_t i = 0; i < pixels_.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      const Pixel& pixel = pixels_[i];
      picture.pixels()[3 * i + c] =
          pixel.n == 0 ? 0.0F
                       : static_cast<float>(pixel.sum[static_cast<Eigen::Index>(c)] / pixel.n);
    }
  }
  return picture;
}

Image<float> Film::standard_error() const {
  Image<float> picture(height_, width_, 3);
  for (std::size_t i = 0; i < pixels_.size(); ++i) {
    const Vector3d squared = squared_error(pixels_[i]);
    for (std::size_t c = 0; c < 3; ++c) {
      picture.pixels()[3 * i + c] =
          static_cast<float>(std::sqrt(squared[static_cast<Eigen::Index>(c)]));
    }
  }
  return picture;
}

FilmError Film::error() const {
  double squared = 0.0;
  double norm = 0.0;
  for (const Pixel& pixel : pixels_) {
    squared += squared_error(pixel).sum();
    norm += pixel.n == 0 ? 0.0 : (pixel.sum / static_cast<double>(pixel.n)).squaredNorm();
  }
  const double light = norm - squared;
  const bool is_known = std::isfinite(light) && light > 0.0;
  return {.relative_l2 =
              is_known ? std::sqrt(squared / light) : std::numeric_limits<double>::infinity(),
          .is_black = norm == 0.0};
}

}  // namespace haarlight::render
