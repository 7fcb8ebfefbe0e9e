// SPDX-License-Identifier: Apache-2.0
#include "render/film/film.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

/// As how many samples of a pixel's own its neighbours' variance counts.
constexpr double kNeighbourSamples = 32.0;

std::size_t to_index(int i) { return static_cast<std::size_t>(i); }

/// Of one value: n samples, their sum and the sum of their squares.
double squared_error(double n, double sum, double squares) {
  if (n < 2.0) {
    return std::numeric_limits<double>::infinity();
  }
  const double mean = sum / n;
  // Rounding may leave a little less than nothing where all samples are equal.
  return std::max(0.0, squares / n - mean * mean) / (n - 1.0);
}

/// Sums of one pixel.
std::size_t sums_of(std::span<const FilmLayer> layers) {
  std::size_t n = 0;
  for (const FilmLayer& layer : layers) {
    n += to_index(layer.channels) * (layer.has_error ? 2 : 1);
  }
  return n;
}

}  // namespace

FilmTile::FilmTile(const Tile& area, const std::vector<FilmLayer>& layers) : area_(area) {
  for (const FilmLayer& layer : layers) {
    const std::size_t channels = to_index(layer.channels);
    offsets_.push_back({.sum = per_pixel_,
                        .squares = layer.has_error ? per_pixel_ + channels : 0,
                        .channels = channels});
    per_pixel_ += channels * (layer.has_error ? 2 : 1);
  }
  sums_.resize(to_index(area.width()) * to_index(area.height()) * per_pixel_);
}

void FilmTile::add(int x, int y, std::size_t layer, std::span<const double> values) {
  const Offset& offset = offsets_[layer];
  HAARLIGHT_ASSERT(x >= area_.x0 && x < area_.x1 && y >= area_.y0 && y < area_.y1 &&
                   values.size() == offset.channels);
  double* const pixel =
      sums_.data() +
      per_pixel_ * (to_index(y - area_.y0) * to_index(area_.width()) + to_index(x - area_.x0));
  for (std::size_t c = 0; c < offset.channels; ++c) {
    HAARLIGHT_ASSERT(std::isfinite(values[c]));
    pixel[offset.sum + c] += values[c];
    if (offset.squares != 0) {
      pixel[offset.squares + c] += values[c] * values[c];
    }
  }
}

Film::Film(int width, int height, std::vector<FilmLayer> layers)
    : width_(width),
      height_(height),
      across_((width + kTile - 1) / kTile),
      layers_(std::move(layers)) {
  HAARLIGHT_EXPECTS(width > 0 && height > 0, "a picture with pixels");
  HAARLIGHT_EXPECTS(!layers_.empty() && layers_.front().channels > 0, "a layer");
  tiles_.resize(to_index(across_) * to_index((height + kTile - 1) / kTile));
  const FilmLayer& picture = layers_.front();
  if (picture.has_splats) {
    HAARLIGHT_EXPECTS(picture.channels == 3 && picture.has_error,
                      "splats of RGB, with an error");
    splats_.resize(to_index(width) * to_index(height));
  }
}

std::uint64_t Film::bytes_needed(int width, int height, std::span<const FilmLayer> layers) {
  const std::uint64_t splats =
      !layers.empty() && layers.front().has_splats ? sizeof(SplatPixel) : 0;
  return static_cast<std::uint64_t>(width) * static_cast<std::uint64_t>(height) *
         (sizeof(double) * sums_of(layers) + splats);
}

Tile Film::area_of(std::size_t tile) const {
  HAARLIGHT_ASSERT(tile < tiles_.size());
  const int x0 = kTile * static_cast<int>(tile % to_index(across_));
  const int y0 = kTile * static_cast<int>(tile / to_index(across_));
  return {.x0 = x0,
          .y0 = y0,
          .x1 = std::min(x0 + kTile, width_),
          .y1 = std::min(y0 + kTile, height_)};
}

std::uint32_t Film::samples_of(std::size_t tile) const {
  const std::lock_guard lock(mutex_);
  return tiles_[tile] == nullptr ? 0 : tiles_[tile]->samples();
}

FilmTile Film::take(std::size_t tile) const {
  std::shared_ptr<const FilmTile> held;
  {
    const std::lock_guard lock(mutex_);
    held = tiles_[tile];
  }
  return held == nullptr ? FilmTile(area_of(tile), layers_) : *held;
}

void Film::put(std::size_t tile, FilmTile sums) {
  const std::vector<FilmTile::Splat> splats = sums.take_splats();
  auto held = std::make_shared<const FilmTile>(std::move(sums));
  const std::lock_guard lock(mutex_);
  for (const FilmTile::Splat& splat : splats) {
    HAARLIGHT_ASSERT(splat.value.allFinite());
    SplatPixel& pixel = splats_.at(to_index(splat.y) * to_index(width_) + to_index(splat.x));
    pixel.light.add(splat.value);
    pixel.squares.add(splat.value.cwiseAbs2());
  }
  tiles_[tile].swap(held);
}

std::vector<std::shared_ptr<const FilmTile>> Film::tiles() const {
  const std::lock_guard lock(mutex_);
  return tiles_;
}

FilmState Film::state() const {
  const std::lock_guard lock(mutex_);
  return {.tiles = tiles_, .splats = splats_};
}

void Film::add_splats(std::span<const SplatPixel> splats) {
  const std::lock_guard lock(mutex_);
  HAARLIGHT_EXPECTS(splats.size() == splats_.size(), "of a film of the same size and layers");
  for (std::size_t i = 0; i < splats.size(); ++i) {
    splats_[i].light.add(splats[i].light);
    splats_[i].squares.add(splats[i].squares);
  }
}

/// A value of a pixel.
struct Film::Seen {
  std::size_t pixel = 0;  ///< row-major
  std::size_t channel = 0;
  double samples = 0.0;
  double mean = 0.0;
  double squared_error = 0.0;  ///< of a layer with an error
};

/// visit(Seen): of pixels with samples.
template <class Visit>
void Film::for_each_pixel(std::size_t layer, const Visit& visit) const {
  const std::span<const FilmLayer> before = std::span(layers_).first(layer);
  const std::size_t first = sums_of(before);
  const std::size_t per_pixel = sums_of(layers_);
  const std::size_t channels = to_index(layers_[layer].channels);
  const bool has_error = layers_[layer].has_error;
  const bool has_splats = layers_[layer].has_splats;
  const FilmState state = this->state();
  double n_all = 0.0;  // samples of all pixels: each may have sent to any of them
  for (const std::shared_ptr<const FilmTile>& tile : state.tiles) {
    if (tile != nullptr) {
      n_all +=
          static_cast<double>(tile->samples()) * tile->area().width() * tile->area().height();
    }
  }
  for (const std::shared_ptr<const FilmTile>& tile : state.tiles) {
    if (tile == nullptr || tile->samples() == 0) {
      continue;
    }
    const Tile& area = tile->area();
    const double n = tile->samples();
    const double* pixel = tile->sums().data() + first;
    for (int y = area.y0; y < area.y1; ++y) {
      for (int x = area.x0; x < area.x1; ++x, pixel += per_pixel) {
        Seen seen{.pixel = to_index(y) * to_index(width_) + to_index(x), .samples = n};
        Eigen::Vector3d sent = Eigen::Vector3d::Zero();
        Eigen::Vector3d squares = Eigen::Vector3d::Zero();
        if (has_splats) {
          sent = state.splats[seen.pixel].light.value();
          squares = state.splats[seen.pixel].squares.value();
        }
        for (std::size_t c = 0; c < channels; ++c) {
          seen.channel = c;
          seen.mean = pixel[c] / n;
          seen.squared_error =
              has_error ? squared_error(n, pixel[c], pixel[channels + c]) : 0.0;
          if (has_splats) {
            const auto i = static_cast<Eigen::Index>(c);
            seen.mean += sent[i] / n_all;
            seen.squared_error += squared_error(n_all, sent[i], squares[i]);
          }
          visit(seen);
        }
      }
    }
  }
}

Image<float> Film::mean(std::size_t layer) const {
  Image<float> picture(height_, width_, layers_[layer].channels);
  const std::size_t channels = to_index(layers_[layer].channels);
  for_each_pixel(layer, [&](const Seen& seen) {
    picture.pixels()[channels * seen.pixel + seen.channel] = static_cast<float>(seen.mean);
  });
  return picture;
}

Image<float> Film::standard_error(std::size_t layer) const {
  HAARLIGHT_EXPECTS(layers_[layer].has_error, "a layer with an error");
  Image<float> picture(height_, width_, layers_[layer].channels);
  std::fill(picture.pixels().begin(), picture.pixels().end(),
            std::numeric_limits<float>::infinity());
  const std::size_t channels = to_index(layers_[layer].channels);
  for_each_pixel(layer, [&](const Seen& seen) {
    picture.pixels()[channels * seen.pixel + seen.channel] =
        static_cast<float>(std::sqrt(seen.squared_error));
  });
  return picture;
}

Image<float> Film::stated_error(std::size_t layer) const {
  HAARLIGHT_EXPECTS(layers_[layer].has_error, "a layer with an error");
  const int channels = layers_[layer].channels;
  Image<double> variance(height_, width_, channels);
  Image<double> samples(height_, width_, 1);
  std::ranges::fill(variance.pixels(), std::numeric_limits<double>::infinity());
  for_each_pixel(layer, [&](const Seen& seen) {
    variance.pixels()[to_index(channels) * seen.pixel + seen.channel] =
        seen.samples * seen.squared_error;
    samples.pixels()[seen.pixel] = seen.samples;
  });
  const auto about = [&](int y, int x, int c) {
    double sum = 0.0;
    int n = 0;
    for (int at_y = std::max(y - 1, 0); at_y < std::min(y + 2, height_); ++at_y) {
      for (int at_x = std::max(x - 1, 0); at_x < std::min(x + 2, width_); ++at_x) {
        const double value = variance(at_y, at_x, c);
        if (std::isfinite(value)) {
          sum += value;
          ++n;
        }
      }
    }
    return sum / n;
  };
  Image<float> picture(height_, width_, channels);
  for (int y = 0; y < height_; ++y) {
    for (int x = 0; x < width_; ++x) {
      for (int c = 0; c < channels; ++c) {
        const double own = variance(y, x, c);
        const double n = samples(y, x, 0);
        picture(y, x, c) =
            std::isfinite(own)
                ? static_cast<float>(std::sqrt((n * own + kNeighbourSamples * about(y, x, c)) /
                                               (n + kNeighbourSamples) / n))
                : std::numeric_limits<float>::infinity();
      }
    }
  }
  return picture;
}

FilmError Film::error(std::size_t layer) const {
  HAARLIGHT_EXPECTS(layers_[layer].has_error, "a layer with an error");
  double squared = 0.0;
  double norm = 0.0;
  for_each_pixel(layer, [&](const Seen& seen) {
    squared += seen.squared_error;
    norm += seen.mean * seen.mean;
  });
  const double light = norm - squared;
  const bool is_known = std::isfinite(light) && light > 0.0;
  return {.relative_l2 =
              is_known ? std::sqrt(squared / light) : std::numeric_limits<double>::infinity(),
          .is_black = norm == 0.0};
}

}  // namespace haarlight::render
