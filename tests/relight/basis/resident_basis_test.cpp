// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/resident_basis.h"

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/relight/basis/compress.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

constexpr int kSide = 8;
constexpr Eigen::Index kLights = Eigen::Index{kSide} * kSide;

LightWeights some_weights(int colours, double first) {
  LightWeights weights(kSide * kSide, colours);
  for (Eigen::Index k = 0; k < weights.rows(); ++k) {
    for (Eigen::Index c = 0; c < colours; ++c) {
      weights(k, c) = k % 5 == 0 ? 0.0 : first + 0.01 * double(k) - 0.3 * double(c);
    }
  }
  return weights;
}

TEST(ResidentBasis, GivesTheBitsOfTheFile) {
  const testing::TemporaryFolder folder;
  for (const int channels : {1, 3}) {
    const auto stack = test::make_stack({.grid = kSide, .channels = channels});
    for (const double error : {0.02, 0.0}) {
      const std::filesystem::path file =
          folder.path() / (std::to_string(channels) + (error > 0.0 ? "q.hlb" : "e.hlb"));
      (void)compress_stack(made_source(stack, kSide), file, {.relative_l2 = error});
      const BasisFile basis = BasisFile::open(file);
      const ResidentBasis resident(basis, std::uint64_t{1} << 30U);
      LightWeights one = LightWeights::Zero(kLights, 1);
      one(19, 0) = 0.7;
      const std::vector<LightWeights> weights = {
          one, some_weights(1, 0.2), some_weights(3, -0.1), LightWeights::Zero(kLights, 1)};
      for (const RelightOptions& options :
           {RelightOptions{}, RelightOptions{.terms = 5}, RelightOptions{.terms = 0},
            RelightOptions{.max_error = 0.1},
            RelightOptions{.terms = 9, .order = TermOrder::light}}) {
        const auto from_file = relight(basis, weights, options);
        const auto from_memory = relight(resident, weights, options);
        ASSERT_EQ(from_file.size(), from_memory.size());
        for (std::size_t i = 0; i < weights.size(); ++i) {
          EXPECT_TRUE(std::ranges::equal(from_file[i].picture.pixels(),
                                         from_memory[i].picture.pixels()));
          EXPECT_EQ(from_file[i].bound.relative_l2, from_memory[i].bound.relative_l2);
          EXPECT_EQ(from_file[i].terms, from_memory[i].terms);
          EXPECT_EQ(from_memory[i].method, "memory");
        }
      }
      EXPECT_THROW(ResidentBasis(basis, 1000), Error);
    }
  }
}

}  // namespace
}  // namespace haarlight::relight
