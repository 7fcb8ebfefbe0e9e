// SPDX-License-Identifier: Apache-2.0
#include "render/loop/pilot.h"

#include <cmath>
#include <cstdint>
#include <ctime>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "core/cpu_time.h"
#include "core/random.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

const std::vector<FilmLayer> kLayers{{.name = "picture", .channels = 3, .has_error = true}};

/// A sample is 1 + deviation x uniform noise of variance 1 in each channel, and takes some time. In
/// one of `rare` pixels a sample is brighter by `flash`.
struct Source {
  double deviation = 1.0;
  double seconds = 0.0;  ///< CPU, of a pixel's sample
  int rare = 0;          ///< 0: none flashes
  double flash = 0.0;
  double light = 1.0;
};

class Noise final : public TileRenderer {
 public:
  Noise(const Source& source, std::uint64_t seed) : source_(source), seed_(seed) {}

  std::uint64_t render_tile(SampleRange samples, FilmTile& tile) const override {
    const double start = thread_cpu_seconds();
    const Tile& area = tile.area();
    for (std::uint32_t i = samples.first; i < samples.end; ++i) {
      for (int y = area.y0; y < area.y1; ++y) {
        for (int x = area.x0; x < area.x1; ++x) {
          const std::uint64_t key =
              hash_key(seed_, static_cast<std::uint64_t>(x), static_cast<std::uint64_t>(y), i);
          Vector3d value;
          for (int c = 0; c < 3; ++c) {
            const double u = uniform_unit(hash_key(key, static_cast<std::uint64_t>(c)));
            value[c] = source_.light * (1.0 + source_.deviation * std::sqrt(12.0) * (u - 0.5));
          }
          if (source_.rare > 0 &&
              hash_key(key, 7) % static_cast<std::uint64_t>(source_.rare) == 0) {
            value += Vector3d::Constant(source_.flash);
          }
          tile.add(x, y, 0, value);
        }
      }
    }
    const double until =
        start + source_.seconds * (samples.end - samples.first) * area.width() * area.height();
    while (thread_cpu_seconds() < until) {
    }
    return 1;
  }

 private:
  Source source_;
  std::uint64_t seed_;
};

PilotCandidate candidate_of(const std::string& name, const Source& source, double bias = 0.0) {
  return {.name = name, .bias = bias, .layers = kLayers, .make = [source](std::uint64_t seed) {
            return std::make_unique<Noise>(source, seed);
          }};
}

constexpr double kTime =
    2e-7;  // of a sample: a patch takes 50 microseconds, thousands of clock steps

TEST(Pilot, TheLeastVarianceTimesTimeIsChosen) {
  // Variance x time over that of the first: 1, 1/4 x 2 = 1/2, 1 x 1/4.
  const std::vector<PilotCandidate> candidates{
      candidate_of("first", {.deviation = 1.0, .seconds = 20.0 * kTime}),
      candidate_of("less noise", {.deviation = 0.5, .seconds = 40.0 * kTime}),
      candidate_of("less time", {.deviation = 1.0, .seconds = 5.0 * kTime})};
  const PilotResult found =
      run_pilot(candidates, {.width = 200, .height = 100, .relative_l2 = 0.005});
  EXPECT_EQ(found.chosen, 2U);
  ASSERT_EQ(found.scores.size(), 3U);
  // Times on a machine that others use, too: a fourth.
  EXPECT_NEAR(found.scores[1].efficiency, 2.0, 0.5);
  EXPECT_NEAR(found.scores[2].efficiency, 4.0, 1.0);
  EXPECT_FALSE(found.is_doubtful);
}

TEST(Pilot, PredictsTheSamplesThatTheRunNeeds) {
  for (const double deviation : {0.1, 1.0, 3.0}) {
    const Source source{.deviation = deviation};
    const std::vector<PilotCandidate> candidates{candidate_of("only", source)};
    // Of n samples the error is deviation / sqrt(n): of an even picture.
    const double error = deviation / 10.0;
    const PilotResult found = run_pilot(
        candidates, {.width = 130, .height = 70, .relative_l2 = error, .free_seconds = 1.0});
    ASSERT_TRUE(found.for_error);
    EXPECT_NEAR(found.for_error->samples, 100.0, 100.0 * (found.for_error->factor - 1.0) * 2.0)
        << "four standard errors";
    EXPECT_LT(found.for_error->factor, 1.25);
    Film film(130, 70, kLayers);
    const RunResult run_result = run(Noise(source, 3), {.relative_l2 = error}, film);
    EXPECT_EQ(run_result.end, RunEnd::error);
    EXPECT_NEAR(found.for_error->end, run_result.samples, 0.26 * run_result.samples)
        << "one look at the error away, at most";
  }
}

TEST(Pilot, TheFirstIsTakenWhereNoOtherIsBetterBeyondDoubt) {
  const Source source{.seconds = kTime};
  const std::vector<PilotCandidate> candidates{candidate_of("first", source),
                                               candidate_of("the same", source)};
  int n_others = 0;
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    n_others +=
        run_pilot(candidates, {.width = 64, .height = 64, .seed = seed}).chosen == 1 ? 1 : 0;
  }
  // By chance one in 44 (two standard errors on one side): 6 or more of 40 in one run of 3000.
  EXPECT_LE(n_others, 5);
}

TEST(Pilot, FewBrightPixelsAreTold) {
  // One in 300 000 samples is 1000 times as bright as the rest: a pilot meets none, or a few.
  const Source calm{.deviation = 1.0, .seconds = kTime};
  const Source flashing{.deviation = 0.2, .seconds = kTime, .rare = 300'000, .flash = 1000.0};
  int n_met = 0;
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    const std::vector<PilotCandidate> only{candidate_of("flashing", flashing)};
    const PilotOptions options{.width = 256, .height = 256, .seed = seed, .relative_l2 = 0.02};
    const PilotResult alone = run_pilot(only, options);
    if (alone.scores[0].samples_for_unit > 0.2) {  // 0.04 without a flash
      ++n_met;
      EXPECT_TRUE(alone.is_doubtful) << seed;
      // Nor is it chosen for what it shows elsewhere.
      const std::vector<PilotCandidate> both{candidate_of("calm", calm),
                                             candidate_of("flashing", flashing)};
      EXPECT_EQ(run_pilot(both, options).chosen, 0U) << seed;
    }
  }
  EXPECT_GE(n_met, 2);
}

/// Light of 1 in each pixel, without noise, and as much by splats: each sample sends to a pixel at random.
/// Tells of others.
class Sprinkler final : public TileRenderer {
 public:
  struct Words {
    double squares = 0.0;  ///< of a sample of others
    double unmet = 0.0;
    double seconds = 0.0;  ///< CPU, of each call
  };
  Sprinkler(const Words& words, std::uint64_t seed) : words_(words), seed_(seed) {}
  static constexpr int kSide = 64;

  std::uint64_t render_tile(SampleRange samples, FilmTile& tile) const override {
    const Tile& area = tile.area();
    const double until = thread_cpu_seconds() + words_.seconds;
    while (thread_cpu_seconds() < until) {
    }
    for (std::uint32_t i = samples.first; i < samples.end; ++i) {
      for (int y = area.y0; y < area.y1; ++y) {
        for (int x = area.x0; x < area.x1; ++x) {
          const std::uint64_t key =
              hash_key(seed_, static_cast<std::uint64_t>(x), static_cast<std::uint64_t>(y), i);
          tile.add(x, y, 0, Vector3d::Ones());
          tile.add_splat(static_cast<int>(hash_key(key, 1) % kSide),
                         static_cast<int>(hash_key(key, 2) % kSide),
                         Vector3d::Constant(kSide * kSide));
          tile.add(x, y, 1, std::vector<double>{words_.squares, words_.unmet});
        }
      }
    }
    return 1;
  }

 private:
  Words words_;
  std::uint64_t seed_;
};

PilotCandidate told(PilotCandidate candidate, std::size_t by) {
  candidate.told_by = by;
  return candidate;
}

PilotCandidate sprinkler_of(const Sprinkler::Words& words) {
  return {
      .name = "splats",
      .layers = {{.name = "picture", .channels = 3, .has_error = true, .has_splats = true},
                 {.name = "told", .channels = 2}},
      .make = [words](std::uint64_t seed) { return std::make_unique<Sprinkler>(words, seed); }};
}

/// As many samples as pixels, each with a chance of one in as many to send its light to a pixel: a variance
/// of 1 of a picture of 2.
TEST(Pilot, SplatsAreOfAllSamples) {
  const std::vector<PilotCandidate> candidates{sprinkler_of({})};
  const PilotResult found = run_pilot(
      candidates, {.width = Sprinkler::kSide, .height = Sprinkler::kSide, .relative_l2 = 0.05});
  EXPECT_NEAR(found.scores[0].samples_for_unit, 0.25, 0.005);
  Film film(Sprinkler::kSide, Sprinkler::kSide, candidates[0].layers);
  const RunResult result = run(Sprinkler({}, 3), {.samples = 64}, film);
  EXPECT_NEAR(64.0 * std::pow(result.error.relative_l2, 2), 0.25, 0.01);
}

/// One in 3 million samples of the first is 3000 times as bright as the rest, which adds 3 to the squares
/// of 1 of each colour: no pilot meets one, but another knows of them.
TEST(Pilot, HearsOfLightThatIsHardlyMet) {
  // Times that are far apart, whatever a sanitizer adds: 64 pixels' samples of 4 microseconds.
  const Source flashing{
      .deviation = 0.1, .seconds = 20.0 * kTime, .rare = 3'000'000, .flash = 3000.0};
  const double squares = 3.0 * (1.0 + 0.01 + 3.0);
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    const std::vector<PilotCandidate> candidates{told(candidate_of("flashing", flashing), 1),
                                                 sprinkler_of({.squares = squares})};
    const PilotOptions options{.width = Sprinkler::kSide,
                               .height = Sprinkler::kSide,
                               .seed = seed,
                               .relative_l2 = 0.02};
    const PilotResult found = run_pilot(candidates, options);
    EXPECT_EQ(found.chosen, 1U) << seed;
    EXPECT_TRUE(found.scores[0].is_told);
  }
  // Where it is taken all the same, as the other is slow, its samples are told, too, and not trusted.
  const std::vector<PilotCandidate> slow{told(candidate_of("flashing", flashing), 1),
                                         sprinkler_of({.squares = squares, .seconds = 10e-3})};
  const PilotResult by_first = run_pilot(
      slow, {.width = Sprinkler::kSide, .height = Sprinkler::kSide, .relative_l2 = 0.2});
  EXPECT_EQ(by_first.chosen, 0U);
  EXPECT_NEAR(by_first.scores[0].samples_for_unit, squares / 3.0 - 1.0, 0.01);
  EXPECT_TRUE(by_first.is_doubtful);
  // What says no more than its own samples is not listened to.
  const std::vector<PilotCandidate> plain{
      told(candidate_of("calm", {.deviation = 0.4, .seconds = kTime}), 1),
      sprinkler_of({.squares = 3.0 * 1.1})};
  const PilotResult found =
      run_pilot(plain, {.width = Sprinkler::kSide, .height = Sprinkler::kSide});
  EXPECT_EQ(found.chosen, 0U);
  EXPECT_FALSE(found.scores[0].is_told);
  EXPECT_NEAR(found.scores[0].samples_for_unit, 0.16, 0.01);
}

TEST(Pilot, OneThatNeverMeetsALightIsNotTaken) {
  const std::vector<PilotCandidate> candidates{
      told(candidate_of("blind", {.deviation = 0.1}), 2),
      candidate_of("blind, too", {.deviation = 0.05}),
      sprinkler_of({.squares = 3.0, .unmet = 0.02})};
  const PilotResult found =
      run_pilot(candidates, {.width = Sprinkler::kSide, .height = Sprinkler::kSide});
  EXPECT_EQ(found.chosen, 2U);
  EXPECT_NEAR(found.scores[0].unmet, 0.02 / 6.0,
              1e-9);  // a light of 2 in each of three colours
  const std::vector<PilotCandidate> hardly{
      told(candidate_of("nearly all", {.deviation = 0.1}), 1),
      sprinkler_of({.squares = 3.0, .unmet = 0.002})};
  EXPECT_EQ(run_pilot(hardly, {.width = Sprinkler::kSide, .height = Sprinkler::kSide}).chosen,
            0U);
}

TEST(Pilot, ABiasedOneIsAskedOnlyBelowHalfOfTheError) {
  const std::vector<PilotCandidate> candidates{
      candidate_of("unbiased", {.deviation = 1.0, .seconds = 4.0 * kTime}),
      candidate_of("biased", {.deviation = 0.1, .seconds = kTime}, 0.01)};
  for (const auto& [error, chosen] :
       {std::pair{0.021, std::size_t{1}}, {0.019, std::size_t{0}}, {0.0, std::size_t{0}}}) {
    const PilotResult found =
        run_pilot(candidates, {.width = 64, .height = 64, .relative_l2 = error});
    EXPECT_EQ(found.chosen, chosen) << error;
    EXPECT_EQ(found.scores[1].patches == 0, chosen == 0) << error;
  }
}

TEST(Pilot, WithoutLightNothingIsKnown) {
  const std::vector<PilotCandidate> candidates{candidate_of("dark", {.light = 0.0}),
                                               candidate_of("dark too", {.light = 0.0})};
  const PilotResult found =
      run_pilot(candidates, {.width = 20, .height = 10, .relative_l2 = 0.02, .seconds = 2.0});
  EXPECT_TRUE(found.is_black);
  EXPECT_EQ(found.chosen, 0U);
  EXPECT_FALSE(found.for_error);
  EXPECT_FALSE(found.error_in_time);
}

TEST(Pilot, WithoutNoiseTheFirstLookIsPredicted) {
  const std::vector<PilotCandidate> candidates{candidate_of("exact", {.deviation = 0.0})};
  const PilotResult found =
      run_pilot(candidates, {.width = 20, .height = 10, .relative_l2 = 1e-5});
  ASSERT_TRUE(found.for_error);
  EXPECT_EQ(found.for_error->end, 16U);
  EXPECT_FALSE(found.is_doubtful);
}

TEST(Pilot, TakesItsShareOfTheRun) {
  const Source source{.deviation = 1.0, .seconds = 10.0 * kTime};
  const std::vector<PilotCandidate> candidates{candidate_of("one", source),
                                               candidate_of("other", source)};
  // 2500 samples of 256 x 256 pixels of 2 us: 330 s of CPU time. The clock is the process's.
  for (const double share : {0.002, 0.0005}) {
    const double start = static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
    const PilotResult found = run_pilot(candidates, {.width = 256,
                                                     .height = 256,
                                                     .relative_l2 = 0.02,
                                                     .share = share,
                                                     .free_seconds = 0.0});
    const double spent = static_cast<double>(std::clock()) / CLOCKS_PER_SEC - start;
    ASSERT_TRUE(found.for_error);
    EXPECT_LE(spent, 1.3 * share * 2500.0 * 65536.0 * 10.0 * kTime + 0.02);
    EXPECT_NEAR(found.cpu_seconds, spent, 0.1 * spent + 0.01);
  }
}

TEST(Pilot, AnEfficiencysErrorIsThatOfItsScatter) {
  // Ratios from patches of random variances: the jackknife's error beside their true scatter.
  constexpr int kTrials = 400;
  constexpr std::size_t kPatches = 48;
  double sum = 0.0;
  double squares = 0.0;
  double stated = 0.0;
  for (std::uint64_t trial = 0; trial < kTrials; ++trial) {
    std::vector<PilotPatch> one;
    std::vector<PilotPatch> other;
    for (std::uint64_t i = 0; i < kPatches; ++i) {
      const auto random = [&](std::uint64_t which) {
        return 0.2 + uniform_unit(hash_key(trial, i, which));
      };
      const double shared = random(0);  // what the patch shows
      one.push_back({.variance = shared * random(1), .seconds = random(2), .pixels = 64});
      other.push_back({.variance = shared * random(3), .seconds = random(4), .pixels = 64});
    }
    const EfficiencyRatio ratio = efficiency_ratio(one, other);
    sum += ratio.logarithm;
    squares += ratio.logarithm * ratio.logarithm;
    stated += ratio.error / kTrials;
  }
  const double mean = sum / kTrials;
  const double scatter = std::sqrt(squares / kTrials - mean * mean);
  // The scatter is known to 1 / sqrt(2 x 400) = 3.5 %; four of these.
  EXPECT_NEAR(stated / scatter, 1.0, 0.14);
  EXPECT_LE(std::abs(mean), 4.0 * scatter / std::sqrt(kTrials));
}

}  // namespace
}  // namespace haarlight::render
