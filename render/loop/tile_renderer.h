// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <span>
#include <string_view>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/progress.h"
#include "render/film/film.h"

/// @file
/// The loop that renderers share: tiles on all threads, passes over the picture until the
/// samples, the error or the time requested are reached, or until it is told to stop.

namespace haarlight::render {

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

  /// Adds these samples of the tile's pixels, a few at a time. Called from several threads for
  /// different tiles; what it adds depends on pixel and sample alone.
  /// @return rays cast
  virtual std::uint64_t render_tile(SampleRange samples, FilmTile& tile) const = 0;
};

/// Tiles i with i mod n_parts = index: one computer's work of several.
struct Part {
  std::size_t index = 0;  ///< from 0
  std::size_t n_parts = 1;
};

enum class RunEnd : std::uint8_t {
  samples,  ///< all that were requested
  error,    ///< small enough
  dark,     ///< an error was requested, and 1024 samples of each pixel found no light
  time,
  stopped,
};
inline constexpr auto kRunEndWords =
    std::to_array<std::string_view>({"samples", "error", "dark", "time", "stopped"});
constexpr std::span<const std::string_view> words_of(RunEnd) { return kRunEndWords; }

/// The loop ends with the first of these that is reached.
struct RunOptions {
  static constexpr std::uint32_t kAnySamples = 1U << 20U;  ///< ends by another of these
  std::uint32_t samples = kAnySamples;                     ///< of each pixel
  /// Film::error() of the first layer. Looked at after 16, 20, 25, 32 ... samples of each pixel:
  /// rarely, since an estimate that is looked at often is believed when it is too small, and at
  /// the same counts in a render that was interrupted. 0: not looked at.
  double relative_l2 = 0.0;
  double seconds = std::numeric_limits<double>::infinity();
  /// Time ends it after so many samples of each pixel at least: two, since one has no error. 0: some
  /// tiles may have none then.
  std::uint32_t least_samples = 2;
  Part part;
  std::function<bool()> is_stopped;  ///< from any thread; empty: never
  /// Keeps the film as it is, every so many seconds; from one thread at a time. Empty: not kept.
  std::function<void()> keep;
  double keep_seconds = 60.0;
  ProgressStyle progress = ProgressStyle::none;
};

struct RunResult {
  RunEnd end = RunEnd::samples;
  std::uint32_t samples = 0;       ///< of the pixel that has fewest, also from earlier runs
  std::uint32_t most_samples = 0;  ///< of the pixel that has most
  FilmError error;                 ///< of the first layer; none of one without errors
  std::uint64_t n_rays = 0;
  double seconds = 0.0;
};

/// Goes on from what the film holds. The same film for any number of threads, and whether it was
/// interrupted or not: a tile's samples are added in their order.
[[nodiscard]] RunResult run(const TileRenderer& renderer, const RunOptions& options,
                            Film& film);

}  // namespace haarlight::render
