// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <limits>

#include "haarlight/core/progress.h"
#include "render/film/film.h"

/// @file
/// The loop that renderers share: tiles on all threads, passes over the picture until the
/// samples, the error or the time requested are reached.

namespace haarlight::render {

/// Pixels x0 <= x < x1, y0 <= y < y1.
struct Tile {
  int x0 = 0;
  int y0 = 0;
  int x1 = 0;
  int y1 = 0;
};

/// Samples first <= i < end of each pixel.
struct SampleRange {
  std::uint32_t first = 0;
  std::uint32_t end = 0;
};

class TileRenderer {
 public:
  TileRenderer() = default;
  virtual ~TileRenderer() = default;
  TileRenderer(const TileRenderer&) = delete;
  TileRenderer& operator=(const TileRenderer&) = delete;

  /// Adds these samples of the tile's pixels to the film. Called from several threads for
  /// different tiles; what it adds depends on pixel and sample alone.
  /// @return rays cast
  virtual std::uint64_t render_tile(const Tile& tile, SampleRange samples,
                                    Film& film) const = 0;
};

/// The loop ends with the first of these that is reached, after two samples at least where
/// `samples` allows them: one has no error.
struct RunOptions {
  std::uint32_t samples = 1U << 20U;  ///< of each pixel
  /// Film::error(), looked at from 16 samples on; not awaited of a picture that is black after
  /// 1024. 0: not looked at.
  double relative_l2 = 0.0;
  double seconds = std::numeric_limits<double>::infinity();
  ProgressStyle progress = ProgressStyle::none;
};

struct RunResult {
  std::uint32_t samples = 0;  ///< of each pixel
  FilmError error;
  std::uint64_t n_rays = 0;
  double seconds = 0.0;
};

/// The same film for any number of threads: a tile's samples are added in their order.
[[nodiscard]] RunResult run(const TileRenderer& renderer, const RunOptions& options,
                            Film& film);

}  // namespace haarlight::render
