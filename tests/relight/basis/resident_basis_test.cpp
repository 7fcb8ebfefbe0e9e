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

TEST(ResidentBasis, BeginsWithTheTermsThatKeepAnError) {
  const testing::TemporaryFolder folder;
  const std::filesystem::path file = folder.path() / "q.hlb";
  const auto stack = test::make_stack({.grid = kSide, .channels = 1});
  (void)compress_stack(made_source(stack, kSide), file, {.relative_l2 = 0.005});
  const BasisFile basis = BasisFile::open(file);
  const ResidentBasis resident(basis, std::uint64_t{1} << 30U);
  const auto terms_for = [&](const LightWeights& weights, double max_error) {
    const RelitPicture picture =
        std::move(relight(resident, std::span(&weights, 1), {.max_error = max_error}).front());
    EXPECT_TRUE(picture.bound.relative_l2 <= max_error || picture.terms == picture.terms_all)
        << max_error;
    return picture.terms;
  };
  const LightWeights all = some_weights(1, 0.2);
  int before = 0;
  for (const double error : {2.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01}) {
    const int terms = terms_for(all, error);
    EXPECT_GE(terms, before) << error;
    before = terms;
  }
  EXPECT_LT(terms_for(all, 2.0), 16);  // a search that begins with 16 never takes fewer
  EXPECT_GE(terms_for(all, 0.0), before);
}

}  // namespace
}  // namespace haarlight::relight
