// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <random>
#include <set>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/commission/commission.h"
#include "core/random.h"
#include "haarlight/render/scene/scene.h"
#include "sim/transport.h"
#include "tests/capture/commission/commission_truth.h"
#include "tests/capture/twin_bench.h"

/// @file
/// Swapped lights on what the twin's renderer makes of a scene: shadows, light from one surface
/// to the next, not the point sources on a plane that the survey's own geometry is of.
/// HAARLIGHT_WIRINGS: how many rigs per scene; HAARLIGHT_SEED replays a run.

namespace haarlight::capture {
namespace {

using testing::TemporaryFolder;
using testing::truth_of;
using testing::TwinBench;
using testing::written_rig;

/// Rigs with a swap that was missed: none of 450 before the stairs nor of 450 on the empty
/// plane, so below this fraction with 95 % confidence each (1 - 0.05^(1/n));
/// docs/numerics/commissioning.md.
constexpr double kMissed = 0.0067;

/// A count of `n` that a fraction p exceeds by a chance below one in a thousand (binomial).
int most_of(int n, double p) {
  double term = std::pow(1.0 - p, n);
  double sum = term;
  int k = 0;
  while (sum < 1.0 - 1e-3) {
    ++k;
    term *= (n - k + 1.0) / k * p / (1.0 - p);
    sum += term;
  }
  return k;
}

class RenderedWiring : public ::testing::TestWithParam<const char*> {};

TEST_P(RenderedWiring, TwoSwappedNeighboursAndASwappedFarPairAreFound) {
  const char* requested = std::getenv("HAARLIGHT_WIRINGS");
  const int n = requested == nullptr ? 2 : std::atoi(requested);
  const char* given = std::getenv("HAARLIGHT_SEED");
  const std::uint64_t seed =
      given == nullptr ? std::random_device{}() : std::strtoull(given, nullptr, 10);
  fmt::print("HAARLIGHT_SEED={} HAARLIGHT_WIRINGS={}\n", seed, n);
  const TemporaryFolder folder;
  const Rig written = written_rig(Shutter::global);
  const auto scene = render::read_scene(
      fmt::format("{}/configs/scenes/{}.toml", HAARLIGHT_SOURCE_DIR, GetParam()));
  sim::TransportOptions options;
  options.cache_folder = folder.path();
  int n_missed = 0;
  int n_silent = 0;
  for (int i = 0; i < n; ++i) {
    const auto draw = [&](int what, int below) {
      return static_cast<int>(
          hash_key(seed, static_cast<std::uint64_t>(i), static_cast<std::uint64_t>(what)) %
          static_cast<std::uint64_t>(below));
    };
    // Neighbours in a row of 8, and a pair three rows and three columns apart at least.
    const int near_row = draw(1, 8);
    const int near = 8 * near_row + draw(2, 7);
    const int far_row = (near_row + 1 + draw(3, 3)) % 4;
    const int far = 8 * far_row + draw(4, 4);
    const int other = 8 * (far_row + 4) + 4 + draw(5, 4);
    sim::SimTruth truth = truth_of({TimestampMeaning::start_readout, Shutter::global});
    truth.dead.clear();
    truth.dim.clear();
    truth.swapped = {{near, near + 1}};
    std::set<int> swapped{near, near + 1};
    for (const int k : {far, other}) {
      if (swapped.count(far) == 0 && swapped.count(other) == 0) {
        truth.swapped.emplace_back(far, other);
      }
      swapped.insert(k);
    }
    if (truth.swapped.size() == 1) {
      swapped = {near, near + 1};
    }
    TwinBench bench(written, truth, hash_key(seed, 7, static_cast<std::uint64_t>(i)), 0.0,
                    sim::make_transport(written, 0, scene.scene, options));
    const CommissionResult result =
        commission(written, bench.camera(), bench.lights(), {}, bench.clock());
    const LightSurvey& survey = *result.survey;
    fmt::print(
        "{} {}: swapped [{}], found [{}], unplaced [{}], alike {}, dead {}, dim {}, unseen "
        "{}\n",
        GetParam(), i, fmt::join(swapped, " "), fmt::join(survey.miswired, " "),
        fmt::join(survey.unplaced, " "), survey.alike.size(), survey.dead.size(),
        survey.dim.size(), survey.unseen.size());
    const std::set<int> found(survey.miswired.begin(), survey.miswired.end());
    for (const int k : found) {
      EXPECT_EQ(swapped.count(k), 1U) << k << " is in its position";
    }
    n_missed += found == swapped ? 0 : 1;
    const std::set<int> open(survey.unplaced.begin(), survey.unplaced.end());
    n_silent += std::any_of(swapped.begin(), swapped.end(), [&](int k) {
      return found.count(k) == 0 && open.count(k) == 0 &&
             std::count(survey.alike.begin(), survey.alike.end(), k) == 0;
    });
    EXPECT_TRUE(survey.dead.empty());
  }
  fmt::print("{}: {} of {} rigs with a swap that was missed, {} without a word\n", GetParam(),
             n_missed, n, n_silent);
  EXPECT_LE(n_missed, most_of(n, kMissed));
  EXPECT_EQ(n_silent, 0);
}

INSTANTIATE_TEST_SUITE_P(Scenes, RenderedWiring, ::testing::Values("empty", "stairs"),
                         [](const auto& made) { return std::string(made.param); });

}  // namespace
}  // namespace haarlight::capture
