// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/image.h"
#include "render/film/splat_sum.h"

/// @file
/// What has been seen of a picture so far: sums of samples, in double precision, in tiles of
/// 32 x 32 pixels. A sample belongs to the pixel that it was drawn for, and within a pixel samples
/// are added in their order: the same sums for any number of threads, parts or interruptions.
///
/// What a sample sends to other pixels (splats: paths from the lights) is summed beside them, in numbers
/// that do not depend on the order.

namespace haarlight::render {

/// Pixels x0 <= x < x1, y0 <= y < y1.
struct Tile {
  int x0 = 0;
  int y0 = 0;
  int x1 = 0;
  int y1 = 0;

  [[nodiscard]] int width() const noexcept { return x1 - x0; }
  [[nodiscard]] int height() const noexcept { return y1 - y0; }
};

/// A named quantity of a picture, such as its radiance or the depth of what it shows.
struct FilmLayer {
  std::string name;
  int channels = 3;
  bool has_error = false;  ///< sums its squares too, for a standard error
  /// Of the first layer, with three channels and an error: samples of any pixel add to it.
  bool has_splats = false;

  friend bool operator==(const FilmLayer&, const FilmLayer&) = default;
};

/// One tile's sums, while a single thread works on them.
class FilmTile {
 public:
  FilmTile(const Tile& area, const std::vector<FilmLayer>& layers);

  [[nodiscard]] const Tile& area() const noexcept { return area_; }
  [[nodiscard]] std::uint32_t samples() const noexcept { return samples_; }
  /// After that many samples of each of its pixels have been added.
  void set_samples(std::uint32_t samples) noexcept { samples_ = samples; }

  /// Adds a sample. @param x, y  of the picture, within the tile @param value  finite
  void add(int x, int y, std::size_t layer, double value) {
    add(x, y, layer, std::span<const double>(&value, 1));
  }
  void add(int x, int y, std::size_t layer, const Eigen::Vector3d& value) {
    add(x, y, layer, std::span<const double>(value.data(), 3));
  }
  /// @param values  one for each channel
  void add(int x, int y, std::size_t layer, std::span<const double> values);

  /// What one sample of this tile sends to any pixel of the film. Film::put() adds it there.
  void add_splat(int x, int y, const Eigen::Vector3d& value) {
    splats_.push_back({x, y, value});
  }
  struct Splat {
    int x;
    int y;
    Eigen::Vector3d value;
  };
  [[nodiscard]] const std::vector<Splat>& splats() const noexcept { return splats_; }
  [[nodiscard]] std::vector<Splat> take_splats() { return std::exchange(splats_, {}); }

  /// All sums: row by row, of each pixel layer by layer its channels' and then their squares'.
  [[nodiscard]] std::span<const double> sums() const noexcept { return sums_; }
  [[nodiscard]] std::span<double> sums() noexcept { return sums_; }

 private:
  struct Offset {
    std::size_t sum;
    std::size_t squares;  ///< 0: none
    std::size_t channels;
  };
  Tile area_;
  std::uint32_t samples_ = 0;
  std::size_t per_pixel_ = 0;
  std::vector<Offset> offsets_;  ///< by layer
  std::vector<double> sums_;
  std::vector<Splat> splats_;  ///< that wait for Film::put()
};

/// What a film holds at one moment.
struct FilmState {
  std::vector<std::shared_ptr<const FilmTile>> tiles;  ///< nothing where a tile has no samples
  std::vector<SplatPixel> splats;  ///< of all pixels, row by row; empty: of a film without
};

/// How far a picture's mean may be off, from the samples alone.
struct FilmError {
  /// sqrt(sum of the squared standard errors) / ||picture||, over all pixels and channels. The
  /// noise's own part of the means' squares is taken off: it would make a picture of noise look
  /// known. Infinite where that leaves nothing, while a pixel has fewer than two samples, and
  /// where no sample has found light yet.
  double relative_l2 = 0.0;
  bool is_black = false;  ///< no sample has found light
};

/// Thread-safe.
class Film {
 public:
  static constexpr int kTile = 32;

  /// @param layers  the first is the picture
  Film(int width, int height, std::vector<FilmLayer> layers);

  /// What its sums take, for a check before they are allocated.
  [[nodiscard]] static std::uint64_t bytes_needed(int width, int height,
                                                  std::span<const FilmLayer> layers);

  [[nodiscard]] int width() const noexcept { return width_; }
  [[nodiscard]] int height() const noexcept { return height_; }
  [[nodiscard]] const std::vector<FilmLayer>& layers() const noexcept { return layers_; }
  /// Row by row.
  [[nodiscard]] std::size_t n_tiles() const noexcept { return tiles_.size(); }
  [[nodiscard]] Tile area_of(std::size_t tile) const;
  [[nodiscard]] std::uint32_t samples_of(std::size_t tile) const;

  /// A tile's sums so far, to add to, and back again.
  [[nodiscard]] FilmTile take(std::size_t tile) const;
  void put(std::size_t tile, FilmTile sums);
  /// All tiles as they are now; nothing where a tile has no samples.
  [[nodiscard]] std::vector<std::shared_ptr<const FilmTile>> tiles() const;
  /// The same with the splats, which are those of the samples that these tiles have.
  [[nodiscard]] FilmState state() const;
  /// Adds what another part of the picture has sent. @param splats  FilmState::splats
  void add_splats(std::span<const SplatPixel> splats);

  /// 0 where there are no samples.
  [[nodiscard]] Image<float> mean(std::size_t layer) const;
  /// Of the mean: sqrt(variance of the samples / their number); infinite before there are two. With
  /// splats the variance of those is added, taken of all samples of the film, most of which send a
  /// pixel nothing, and as if each splat came from a sample of its own.
  /// Samples that are spread evenly (Sobol's) make a smaller error than independent ones: this
  /// is then usually too large. @param layer  with has_error
  [[nodiscard]] Image<float> standard_error(std::size_t layer) const;
  /// The same to be stated: of the variance of the pixel's own n samples and that in the 3 x 3 pixels
  /// about it, weighted n to 32. Few skewed samples know their variance badly, and too small where
  /// their mean is too small: with the neighbours' the truth lies within 1.96 of it nearly as often as
  /// for normal estimates (docs/numerics/surface.md).
  [[nodiscard]] Image<float> stated_error(std::size_t layer) const;
  /// Of a layer, over the tiles that have samples.
  [[nodiscard]] FilmError error(std::size_t layer) const;

 private:
  struct Seen;
  template <class Visit>
  void for_each_pixel(std::size_t layer, const Visit& visit) const;

  int width_;
  int height_;
  int across_;  ///< tiles of a row
  std::vector<FilmLayer> layers_;
  mutable std::mutex mutex_;
  std::vector<std::shared_ptr<const FilmTile>> tiles_;
  std::vector<SplatPixel> splats_;
};

}  // namespace haarlight::render
