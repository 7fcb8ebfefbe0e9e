// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/relight_pilot.h"

#include <algorithm>
#include <numeric>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/relight/basis/compress.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/session/small_session.h"

namespace haarlight::relight {
namespace {

constexpr int kLights = 64;

/// 70 x 40 pixels, 6 tiles, under 8 x 8 lights.
class RelightPilot : public testing::Test {
 protected:
  BasisFile file(double max_error = 0.01) {
    const auto path = folder_.path() / "a.hlb";
    (void)compress_stack(test::made_source(stack(), 8), path, {.relative_l2 = max_error});
    return BasisFile::open(path);
  }
  static const MemoryStack& stack() {
    return test::make_stack({.width = 70, .height = 40, .grid = 8});
  }
  static LightWeights random_weights(std::uint64_t seed) {
    LightWeights w(kLights, 1);
    for (int k = 0; k < kLights; ++k) {
      w(k, 0) = uniform_unit(hash_key(seed, static_cast<std::uint64_t>(k)));
    }
    return w;
  }
  test::TemporaryFolder folder_;
};

TEST_F(RelightPilot, CountsWhatEveryTermNeeds) {
  const BasisFile basis = file();
  const std::vector<LightWeights> weights = {random_weights(1)};
  LightQueries queries(basis.header(), basis.tables(), basis.name(), weights);
  FilePassCost cost;
  cost.n_groups = basis.n_groups();
  for (int g = 0; g < basis.n_groups(); ++g) {
    cost.unpack.push_back(100.0 * (g + 1));
  }
  cost.term.assign(kLights, 1.0);
  cost.pixels = 7.0;
  cost.picture = 3.0;
  const std::vector<double> seconds =
      file_seconds_by_terms(basis, cost, queries, 0, TermOrder::transport, 1.0);
  const std::vector<int>& ranked = queries.ranked(0, TermOrder::transport);
  ASSERT_EQ(seconds.size(), ranked.size() + 1);
  EXPECT_EQ(seconds.front(), 10.0);
  // By hand: every group of the first K, once; a product for every term.
  for (std::size_t k = 0; k < seconds.size(); ++k) {
    double expected = 10.0 + static_cast<double>(k);
    for (int g = 0; g < basis.n_groups(); ++g) {
      const bool is_needed = std::any_of(
          ranked.begin(), ranked.begin() + static_cast<std::ptrdiff_t>(k), [&](int i) {
            for (int at = basis.group_begin(g); at < basis.group_end(g); ++at) {
              if (basis.order()[static_cast<std::size_t>(at)] == i) {
                return true;
              }
            }
            return false;
          });
      expected += is_needed ? 100.0 * (g + 1) : 0.0;
    }
    EXPECT_DOUBLE_EQ(seconds[k], expected) << k;
  }
  // Eight pictures share the reading, not the products.
  const std::vector<double> shared =
      file_seconds_by_terms(basis, cost, queries, 0, TermOrder::transport, 8.0);
  const double unpack = std::accumulate(cost.unpack.begin(), cost.unpack.end(), 7.0);
  EXPECT_NEAR(shared.back(), seconds.back() - 7.0 / 8.0 * unpack, 1e-9);
}

TEST_F(RelightPilot, MoreTermsNeverCostLess) {
  const BasisFile basis = file();
  const std::vector<int> tiles = pilot_tiles(basis);
  for (std::uint64_t seed = 0; seed < 4; ++seed) {
    const std::vector<LightWeights> weights = {random_weights(seed), random_weights(seed + 9)};
    const FilePilot pilot = pilot_file(basis, weights, tiles);
    LightQueries queries(basis.header(), basis.tables(), basis.name(), weights);
    const MemoryCost memory = pilot_memory(basis, 2, tiles);
    for (const int e : {0, 1}) {
      const std::vector<double> file_seconds =
          file_seconds_by_terms(basis, pilot.cost, queries, e, TermOrder::transport, 2.0);
      EXPECT_TRUE(std::is_sorted(file_seconds.begin(), file_seconds.end()));
      EXPECT_GT(file_seconds.front(), 0.0);
      const std::vector<double> in_memory =
          memory_seconds_by_terms(memory, pilot.cost.picture, queries, e, TermOrder::transport);
      EXPECT_EQ(in_memory.size(), file_seconds.size());
      EXPECT_TRUE(std::is_sorted(in_memory.begin(), in_memory.end()));
      EXPECT_LE(in_memory.back(), pilot.cost.picture + memory.rows.front() + 1e-12);
    }
  }
}

TEST_F(RelightPilot, OfAllTilesKnowsTheNormLessItsDoubt) {
  const BasisFile basis = file();
  std::vector<int> tiles(static_cast<std::size_t>(basis.n_tiles()));
  std::iota(tiles.begin(), tiles.end(), 0);
  const std::vector<LightWeights> weights = {random_weights(1), LightWeights::Zero(kLights, 1)};
  EXPECT_EQ(pilot_share(basis, tiles), 2.0);  // two sums
  const FilePilot pilot = pilot_file(basis, weights, tiles);
  const std::vector<RelitPicture> pictures = relight(basis, weights);
  EXPECT_LE(pilot.norms[0], pictures[0].bound.picture_norm);
  EXPECT_GE(pilot.norms[0], 0.5 * pictures[0].bound.picture_norm);
  EXPECT_EQ(pilot.norms[1], 0.0);
}

TEST_F(RelightPilot, TakesAFewTiles) {
  const BasisFile basis = file();
  EXPECT_EQ(pilot_tiles(basis), std::vector<int>{3});
  const HalfCost half = pilot_half(file(0.0), std::vector<LightWeights>{random_weights(1)}, 3);
  EXPECT_GT(half.store, 0.0);
  EXPECT_GT(half.picture, 0.0);
  EXPECT_GT(half.error, 0.0);
  EXPECT_LT(half.error, 0x1p-10);
}

}  // namespace
}  // namespace haarlight::relight
