// SPDX-License-Identifier: Apache-2.0
#include "render/loop/tile_renderer.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "render/loop/looks.h"
#include "render/loop/run_progress.h"

namespace haarlight::render {

namespace {

using Clock = std::chrono::steady_clock;

constexpr std::uint32_t kFirstLook = 16;  // before it no error is believed
constexpr std::uint32_t kMostInTheDark = 1024;
constexpr std::uint32_t kLongestPass = 64;
constexpr std::uint32_t kAtOnce = 4;                        // between two looks at the clock
constexpr std::size_t kMostSplats = std::size_t{1} << 17U;  // that a tile keeps waiting: 4 MiB

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// The first count after `samples` at which the error is looked at: 16, then a quarter more each
/// time, and 1024.
std::uint32_t next_look(std::uint32_t samples) {
  std::uint64_t look = kFirstLook;
  while (look <= samples) {
    look += (look + 3) / 4;
  }
  if (samples < kMostInTheDark) {
    look = std::min<std::uint64_t>(look, kMostInTheDark);
  }
  return static_cast<std::uint32_t>(std::min<std::uint64_t>(look, 0xffffffffU));
}

bool is_look(std::uint32_t samples) { return samples > 0 && next_look(samples - 1) == samples; }

class Run {
 public:
  Run(const TileRenderer& renderer, const RunOptions& options, Film& film)
      : renderer_(renderer), options_(options), film_(film), progress_(options.progress) {
    for (std::size_t i = options.part.index; i < film.n_tiles(); i += options.part.n_parts) {
      tiles_.push_back(i);
    }
    count_samples();
    state_.first_samples = per_tile(n_done_);
    state_.most_seconds = options.seconds;
    if (options.samples < RunOptions::kAnySamples) {
      state_.most_samples = options.samples;
    }
    if (options.relative_l2 > 0.0) {
      state_.requested_error = options.relative_l2;
    }
  }

  RunResult operator()() {
    for (;;) {
      count_samples();
      if (const std::optional<RunEnd> end = is_reached()) {
        result_.end = *end;
        break;
      }
      // Short ones first: should the time end, all pixels have about the same samples.
      const std::uint32_t step = std::clamp(result_.samples, 1U, kLongestPass);
      pass(std::min({options_.samples, next_look(result_.samples), result_.samples + step}));
    }
    if (film_.layers().front().has_error) {
      result_.error = film_.error(0);
    }
    result_.n_rays = n_rays_;
    result_.seconds = seconds_since(start_);
    return result_;
  }

 private:
  void count_samples() {
    result_.samples = tiles_.empty() ? options_.samples : 0xffffffffU;
    result_.most_samples = tiles_.empty() ? options_.samples : 0;
    std::uint64_t sum = 0;
    for (const std::size_t tile : tiles_) {
      const std::uint32_t n = film_.samples_of(tile);
      result_.samples = std::min(result_.samples, n);
      result_.most_samples = std::max(result_.most_samples, n);
      sum += n;
    }
    n_done_ = sum;
  }

  [[nodiscard]] bool is_late() const { return seconds_since(start_) >= options_.seconds; }
  [[nodiscard]] bool is_stopped() const { return options_.is_stopped && options_.is_stopped(); }

  std::optional<RunEnd> is_reached() {
    const std::uint32_t n = result_.samples;
    if (options_.relative_l2 > 0.0 && n == result_.most_samples && is_look(n)) {
      const FilmError error = film_.error(0);
      if (error.relative_l2 <= options_.relative_l2) {
        return RunEnd::error;
      }
      if (error.is_black && n >= kMostInTheDark) {
        return RunEnd::dark;
      }
      const double ratio = error.relative_l2 / options_.relative_l2;
      state_.error = error.relative_l2;
      if (std::isfinite(ratio)) {
        state_.samples_foreseen = n * ratio * ratio;
      }
    }
    if (n >= options_.samples) {
      return RunEnd::samples;
    }
    if (is_stopped()) {
      return RunEnd::stopped;
    }
    if (n >= options_.least_samples && is_late()) {
      return RunEnd::time;
    }
    return std::nullopt;
  }

  void pass(std::uint32_t end) {
    parallel_for(tiles_.size(), 1, [&](std::size_t first, std::size_t last) {
      for (std::size_t i = first; i < last; ++i) {
        if (!is_stopped()) {
          render(tiles_[i], end);
        }
      }
    });
  }

  void render(std::size_t index, std::uint32_t end) {
    FilmTile tile = film_.take(index);
    const std::uint32_t before = tile.samples();
    while (tile.samples() < end && !is_stopped() &&
           !(tile.samples() >= options_.least_samples && is_late())) {
      const SampleRange samples{.first = tile.samples(),
                                .end = std::min(end, tile.samples() + kAtOnce)};
      n_rays_ += renderer_.render_tile(samples, tile);
      tile.set_samples(samples.end);
      tell(n_done_ += samples.end - samples.first);
      if (tile.splats().size() > kMostSplats) {
        film_.put(index, std::move(tile));
        tile = film_.take(index);
      }
    }
    if (tile.samples() > before) {
      film_.put(index, std::move(tile));
      keep();
    }
  }

  void keep() {
    if (!options_.keep) {
      return;
    }
    const std::unique_lock lock(keeping_, std::try_to_lock);
    if (lock.owns_lock() && seconds_since(kept_) >= options_.keep_seconds) {
      options_.keep();
      kept_ = Clock::now();
    }
  }

  [[nodiscard]] double per_tile(std::uint64_t n) const {
    return static_cast<double>(n) /
           static_cast<double>(std::max<std::size_t>(1, tiles_.size()));
  }

  /// What is told of the error is set between the passes.
  void tell(std::uint64_t n_done) {
    RunState state = state_;
    state.samples = per_tile(n_done);
    state.seconds = seconds_since(start_);
    progress_.tell(state);
  }

  const TileRenderer& renderer_;
  const RunOptions& options_;
  Film& film_;
  std::vector<std::size_t> tiles_;
  RunProgress progress_;
  RunState state_;
  const Clock::time_point start_ = Clock::now();
  std::mutex keeping_;
  Clock::time_point kept_ = start_;
  std::atomic<std::uint64_t> n_rays_ = 0;
  std::atomic<std::uint64_t> n_done_ = 0;  ///< samples of tiles
  RunResult result_;
};

}  // namespace

std::uint32_t look_after(double samples) {
  if (!(samples < RunOptions::kAnySamples)) {
    return RunOptions::kAnySamples;
  }
  const double least = std::max(1.0, std::ceil(samples));
  return next_look(static_cast<std::uint32_t>(least) - 1);
}

RunResult run(const TileRenderer& renderer, const RunOptions& options, Film& film) {
  HAARLIGHT_EXPECTS(options.samples >= 1 && options.relative_l2 >= 0.0 && options.seconds > 0.0,
                    "at least one sample, some time");
  HAARLIGHT_EXPECTS(options.part.index < options.part.n_parts, "a part of the picture");
  return Run(renderer, options, film)();
}

}  // namespace haarlight::render
