// SPDX-License-Identifier: Apache-2.0
#include "relight/study/array_binning.h"

#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight::relight {
namespace {

constexpr ArrayGrid kGrid{8, 8, 2};

TEST(ArrayBinning, AnArrayOf32GoesTo16And8) {
  const std::vector<BinChoice> choices = bin_choices({32, 32, 1});
  ASSERT_EQ(choices.size(), 10U);
  EXPECT_TRUE(choices[0].is_area);
  EXPECT_EQ(choices[0].side, 2);
  EXPECT_TRUE(choices[5].is_area);
  EXPECT_EQ(choices[5].side, 4);
  for (std::size_t i = 6; i < 10; ++i) {  // the four around the middle of 4 x 4
    EXPECT_TRUE(choices[i].row == 1 || choices[i].row == 2);
    EXPECT_TRUE(choices[i].col == 1 || choices[i].col == 2);
  }
  EXPECT_TRUE(bin_choices({5, 5, 1}).empty());
  EXPECT_TRUE(bin_choices({2, 2, 1}).empty());
  EXPECT_TRUE(bin_choices({}).empty());
}

TEST(ArrayBinning, KeepsTheWholeLight) {
  Eigen::VectorXd w(128);
  for (Eigen::Index k = 0; k < 128; ++k) {
    w[k] = uniform_unit(hash_key(9, static_cast<std::uint64_t>(k)));
  }
  for (const BinChoice& choice : bin_choices(kGrid)) {
    const Eigen::VectorXd binned = binned_weights(w, kGrid, choice);
    EXPECT_NEAR(binned.head(64).sum(), w.head(64).sum(), 1e-12);
    EXPECT_NEAR(binned.tail(64).sum(), w.tail(64).sum(), 1e-12);
    const auto n_lit = (binned.array() > 0.0).count();
    EXPECT_EQ(n_lit, choice.is_area ? 128 : 128 / (choice.side * choice.side));
  }
}

TEST(ArrayBinning, OneLightBecomesItsBin) {
  Eigen::VectorXd w = Eigen::VectorXd::Zero(128);
  w[64 + 3 * 8 + 5] = 4.0;  // second face, row 3, column 5
  const Eigen::VectorXd area = binned_weights(w, kGrid, {2, true, 0, 0});
  for (const int k : {64 + 2 * 8 + 4, 64 + 2 * 8 + 5, 64 + 3 * 8 + 4, 64 + 3 * 8 + 5}) {
    EXPECT_EQ(area[k], 1.0);
  }
  const Eigen::VectorXd point = binned_weights(w, kGrid, {2, false, 0, 1});
  EXPECT_EQ(point[64 + 2 * 8 + 5], 4.0);
  EXPECT_EQ((point.array() != 0.0).count(), 1);
}

TEST(ArrayBinning, CostsNothingWhereBinsAreConstant) {
  std::vector<float> lights(128);
  for (int k = 0; k < 128; ++k) {
    const int bin = k % 8 / 4 + 2 * (k / 8 / 4);
    lights[static_cast<std::size_t>(k)] = static_cast<float>(bin);
  }
  for (const BinChoice& choice : bin_choices(kGrid)) {
    EXPECT_EQ(binned_energy(lights, kGrid, choice), 0.0);
  }
}

TEST(ArrayBinning, OfOneBrightLightIsOffByAClosedForm) {
  std::vector<float> lights(128);
  lights[0] = 1.0F;  // not in the middle of its bin of 4 x 4
  // Mean: 15 lights off by 1/16, one by 15/16.
  EXPECT_NEAR(binned_energy(lights, kGrid, {4, true, 0, 0}), 15.0 / 16.0, 1e-12);
  EXPECT_NEAR(binned_energy(lights, kGrid, {4, false, 1, 1}), 1.0, 1e-12);
  // As the bin's stand-in it lights all sixteen: fifteen are off by 1.
  EXPECT_NEAR(binned_energy(lights, kGrid, {4, false, 0, 0}), 15.0, 1e-12);
}

}  // namespace
}  // namespace haarlight::relight
