// SPDX-License-Identifier: Apache-2.0
#include "render/loop/tile_renderer.h"

#include <atomic>
#include <cmath>
#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <string>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "core/random.h"
#include "core/temporary_folder.h"
#include "haarlight/core/files.h"
#include "render/film/film_file.h"
#include "render/loop/run_progress.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

const std::vector<FilmLayer> kLayers{{.name = "picture", .channels = 3, .has_error = true},
                                     {.name = "depth", .channels = 1}};
constexpr std::uint64_t kRoom = 1U << 30U;

/// Samples of uniform noise about a mean.
class Noise final : public TileRenderer {
 public:
  explicit Noise(double mean) : mean_(mean) {}

  std::uint64_t render_tile(SampleRange samples, FilmTile& tile) const override {
    EXPECT_EQ(samples.first, tile.samples());
    EXPECT_LT(samples.first, samples.end);
    const Tile& area = tile.area();
    for (std::uint32_t i = samples.first; i < samples.end; ++i) {
      for (int y = area.y0; y < area.y1; ++y) {
        for (int x = area.x0; x < area.x1; ++x) {
          const double u = uniform_unit(
              hash_key(static_cast<std::uint64_t>(x), static_cast<std::uint64_t>(y), i));
          tile.add(x, y, 0, Vector3d::Constant(mean_ * 2.0 * u));
          tile.add(x, y, 1, u);
        }
      }
    }
    ++n_calls;
    return 1;
  }

  mutable std::atomic<int> n_calls = 0;

 private:
  double mean_;
};

std::string bytes_of(const Film& film) {
  const TemporaryFolder folder;
  write_film(folder.path() / "a.film", film, {});
  return read_file(folder.path() / "a.film");
}

TEST(TileRenderer, InterruptedAnywhereAndResumedGivesTheSameBytes) {
  const TemporaryFolder folder;
  const std::filesystem::path path = folder.path() / "a.film";
  for (const double target : {0.0, 0.11}) {
    const RunOptions whole_options{.samples = 45, .relative_l2 = target};
    const Noise noise(1.0);
    Film whole(100, 70, kLayers);
    const RunResult truth = run(noise, whole_options, whole);
    EXPECT_EQ(truth.end, target > 0.0 ? RunEnd::error : RunEnd::samples);
    for (int stop = 0; stop < 20; ++stop) {
      const ThreadLimit limit(1 + stop % 3);
      auto film = std::make_unique<Film>(100, 70, kLayers);
      // 12 tiles, some 15 calls each: stops at one moment, and again at another.
      for (const int calls : {1 + 5 * stop, 3}) {
        const Noise again(1.0);
        RunOptions options = whole_options;
        options.is_stopped = [&again, calls] { return again.n_calls >= calls; };
        const RunResult found = run(again, options, *film);
        EXPECT_EQ(found.end, RunEnd::stopped);
        write_film(path, *film, {});
        film = std::move(read_film(path, kRoom).film);
      }
      const RunResult found = run(noise, whole_options, *film);
      EXPECT_EQ(found.end, truth.end);
      EXPECT_EQ(found.samples, truth.samples);
      EXPECT_EQ(bytes_of(*film), bytes_of(whole)) << stop;
    }
  }
}

TEST(TileRenderer, PartsOnAnyThreadsGiveTheSameBytes) {
  const TemporaryFolder folder;
  const Noise noise(1.0);
  Film whole(100, 70, kLayers);
  (void)run(noise, {.samples = 21}, whole);
  FilmFile joined;
  for (const std::size_t part : {std::size_t{2}, std::size_t{0}, std::size_t{1}}) {
    const ThreadLimit limit(part == 0 ? 1 : part == 1 ? 2 : 7);
    Film film(100, 70, kLayers);
    const RunResult found =
        run(noise, {.samples = 21, .part = {.index = part, .n_parts = 3}}, film);
    EXPECT_EQ(found.samples, 21U);
    const std::filesystem::path path = folder.path() / std::to_string(part);
    write_film(path, film, {});
    FilmFile file = read_film(path, kRoom);
    if (joined.film == nullptr) {
      joined = std::move(file);
    } else {
      join_film(file, path, joined);
    }
  }
  EXPECT_EQ(bytes_of(*joined.film), bytes_of(whole));
}

TEST(TileRenderer, MoreSamplesLaterAreTheSameAsAtOnce) {
  const Noise noise(1.0);
  Film whole(40, 40, kLayers);
  (void)run(noise, {.samples = 50}, whole);
  Film film(40, 40, kLayers);
  (void)run(noise, {.samples = 13}, film);
  const RunResult found = run(noise, {.samples = 50}, film);
  EXPECT_EQ(found.samples, 50U);
  EXPECT_EQ(bytes_of(film), bytes_of(whole));
  EXPECT_EQ(run(noise, {.samples = 13}, film).samples, 50U)
      << "there are no fewer than there are";
}

TEST(TileRenderer, KeepsTheFilmWhileItWorks) {
  const Noise noise(1.0);
  Film film(100, 100, kLayers);
  std::atomic<int> n_kept = 0;
  std::atomic<int> n_at_once = 0;
  RunOptions options{.samples = 16, .keep_seconds = 1e-9};
  options.keep = [&] {
    EXPECT_EQ(++n_at_once, 1) << "one thread at a time";
    ++n_kept;
    --n_at_once;
  };
  (void)run(noise, options, film);
  EXPECT_GE(n_kept, 16);
}

TEST(TileRenderer, NothingSeenIsNoErrorOfNothing) {
  const Noise dark(0.0);
  Film film(2, 2, kLayers);
  const RunResult found = run(dark, {.relative_l2 = 0.5}, film);
  EXPECT_EQ(found.end, RunEnd::dark);
  EXPECT_EQ(found.error.relative_l2, std::numeric_limits<double>::infinity());
  EXPECT_TRUE(found.error.is_black);
  EXPECT_LE(found.samples, 1100U);
}

TEST(TileRenderer, TimeMayLeaveTilesWithoutSamplesWhereThatIsAllowed) {
  const ThreadLimit limit(1);
  const Noise noise(1.0);
  Film film(100, 70, kLayers);
  RunOptions options{.samples = 1, .seconds = 1e-9, .least_samples = 0};
  const RunResult late = run(noise, options, film);
  EXPECT_EQ(late.end, RunEnd::time);
  EXPECT_EQ(late.samples, 0U);
  EXPECT_EQ(noise.n_calls, 0);
  options.seconds = 1e9;
  const RunResult done = run(noise, options, film);
  EXPECT_EQ(done.end, RunEnd::samples);
  options.seconds = 1e-9;  // nothing is left to do: it is not late
  EXPECT_EQ(run(noise, options, film).end, RunEnd::samples);
  EXPECT_EQ(noise.n_calls, 12);
}

TEST(TileRenderer, TwoSamplesAreTakenWhateverTheTime) {
  const Noise noise(1.0);
  Film film(4, 4, kLayers);
  const RunResult found = run(noise, {.seconds = 1e-9}, film);
  EXPECT_EQ(found.samples, 2U);
  EXPECT_EQ(found.end, RunEnd::time);
  Film one(4, 4, kLayers);
  EXPECT_EQ(run(noise, {.samples = 1, .seconds = 1e-9}, one).samples, 1U);
}

TEST(TileRenderer, StopsAtTheErrorAndSaysIt) {
  // Uniform in [0, 2): a sample's deviation is 1/sqrt(3), so that 0.05 takes 134 of them.
  const Noise noise(1.0);
  Film film(64, 64, kLayers);
  const RunResult found = run(noise, {.relative_l2 = 0.05}, film);
  EXPECT_EQ(found.end, RunEnd::error);
  EXPECT_LE(found.error.relative_l2, 0.05);
  EXPECT_GE(found.samples, 130U);
  EXPECT_LE(found.samples, 134U * 5 / 4 + 1);
  double squared = 0.0;
  const Image<float> picture = film.mean(0);
  for (const float value : picture.pixels()) {
    squared += (value - 1.0) * (value - 1.0);
  }
  const double truth = std::sqrt(squared / (64.0 * 64.0 * 3.0));
  // Of 4096 pixels: their root mean square is known to 1/sqrt(2 x 4096) = 1.1 %.
  EXPECT_NEAR(found.error.relative_l2 / truth, 1.0, 0.05);
}

TEST(RunProgress, TellsWhatIsKnownAndNoMore) {
  EXPECT_EQ(progress_words({.samples = 12.5, .most_samples = 50.0, .seconds = 10.0}),
            "12.5 of 50 samples per pixel, 30 s left");
  // It goes on from 10: 2.5 more took 10 s.
  EXPECT_EQ(
      progress_words(
          {.first_samples = 10.0, .samples = 12.5, .most_samples = 50.0, .seconds = 10.0}),
      "12.5 of 50 samples per pixel, 150 s left");
  EXPECT_EQ(progress_words({.samples = 3.0, .requested_error = 0.01, .seconds = 2.0}),
            "3.0 samples per pixel, error not known yet (requested 0.01)");
  EXPECT_EQ(progress_words({.samples = 16.0,
                            .requested_error = 0.01,
                            .error = 0.02,
                            .samples_foreseen = 64.0,
                            .seconds = 2.0}),
            "16.0 samples per pixel, error 0.02 (requested 0.01), 6 s left");
  EXPECT_EQ(progress_words({.samples = 16.0,
                            .requested_error = 0.01,
                            .error = std::numeric_limits<double>::infinity(),
                            .seconds = 2.0,
                            .most_seconds = 9.0}),
            "16.0 samples per pixel, error not known yet (requested 0.01), 7 s left");
  // The first end counts; none is in the past.
  EXPECT_EQ(seconds_left({.samples = 16.0,
                          .most_samples = 32.0,
                          .samples_foreseen = 64.0,
                          .seconds = 2.0,
                          .most_seconds = 9.0}),
            2.0);
  EXPECT_EQ(seconds_left({.samples = 70.0, .samples_foreseen = 64.0, .seconds = 2.0}), 0.0);
  EXPECT_EQ(seconds_left({.most_samples = 32.0}), std::nullopt);
}

TEST(RunProgress, OfARunNamesItsSamplesAndItsError) {
  Film film(64, 64, kLayers);
  testing::internal::CaptureStderr();
  const RunResult result =
      run(Noise(1.0), {.relative_l2 = 0.05, .progress = ProgressStyle::bar}, film);
  const std::string told = testing::internal::GetCapturedStderr();
  EXPECT_EQ(result.end, RunEnd::error);
  EXPECT_EQ(told.find("\rrender: 0."), 0U) << told;
  EXPECT_NE(told.find(" samples per pixel, error not known yet (requested 0.05)"),
            std::string::npos)
      << told;
  EXPECT_EQ(told.find("1000"), std::string::npos) << told;
  EXPECT_EQ(told.back(), '\n');
}

}  // namespace
}  // namespace haarlight::render
