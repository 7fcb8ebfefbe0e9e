// SPDX-License-Identifier: Apache-2.0
#include "render/loop/tile_renderer.h"

#include <algorithm>
#include <atomic>
#include <chrono>

#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

constexpr int kTile = 32;
constexpr std::uint32_t kLeastSamples = 16;  // before an error is believed
constexpr std::uint32_t kLeastForError = 2;
constexpr std::uint32_t kMostInTheDark = 1024;
constexpr std::uint32_t kLongestPass = 64;

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

}  // namespace

RunResult run(const TileRenderer& renderer, const RunOptions& options, Film& film) {
  HAARLIGHT_EXPECTS(options.samples >= 1 && options.relative_l2 >= 0.0 && options.seconds > 0.0,
                    "at least one sample, some time");
  const auto start = std::chrono::steady_clock::now();
  const int across = (film.width() + kTile - 1) / kTile;
  const int down = (film.height() + kTile - 1) / kTile;
  const auto n_tiles = static_cast<std::size_t>(across) * static_cast<std::size_t>(down);
  std::atomic<std::uint64_t> n_rays = 0;
  RunResult result;
  Progress progress("render", n_tiles * options.samples, options.progress);
  while (result.samples < options.samples &&
         (result.samples < kLeastForError || seconds_since(start) < options.seconds)) {
    // Passes grow with what is there, so that looking at the error costs little.
    const std::uint32_t step = std::clamp(result.samples, 1U, kLongestPass);
    const SampleRange pass{
        .first = result.samples,
        .end = result.samples + std::min(step, options.samples - result.samples)};
    parallel_for(n_tiles, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        const int x0 = kTile * static_cast<int>(i % static_cast<std::size_t>(across));
        const int y0 = kTile * static_cast<int>(i / static_cast<std::size_t>(across));
        const Tile tile{.x0 = x0,
                        .y0 = y0,
                        .x1 = std::min(x0 + kTile, film.width()),
                        .y1 = std::min(y0 + kTile, film.height())};
        n_rays += renderer.render_tile(tile, pass, film);
        progress.advance(pass.end - pass.first);
      }
    });
    result.samples = pass.end;
    if (options.relative_l2 > 0.0 && result.samples >= kLeastSamples) {
      const FilmError error = film.error();
      if (error.relative_l2 <= options.relative_l2 ||
          (error.is_black && result.samples >= kMostInTheDark)) {
        break;
      }
    }
  }
  result.error = film.error();
  result.n_rays = n_rays;
  result.seconds = seconds_since(start);
  return result;
}

}  // namespace haarlight::render
