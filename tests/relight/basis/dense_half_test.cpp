// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/dense_half.h"

#include <algorithm>
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "tests/relight/basis/made_stack.h"

namespace haarlight::relight {
namespace {

using test::make_stack;

LightWeights random_weights(std::uint64_t seed, int n, int colours = 1) {
  LightWeights w(n, colours);
  for (int k = 0; k < n; ++k) {
    for (int c = 0; c < colours; ++c) {
      w(k, c) = 2.0 * uniform_unit(hash_key(seed, static_cast<std::uint64_t>(k),
                                            static_cast<std::uint64_t>(c))) -
                1.0;
    }
  }
  return w;
}

LightWeights one_light(int k, int n) {
  LightWeights w = LightWeights::Zero(n, 1);
  w(k, 0) = 1.0;
  return w;
}

/// ||picture - truth|| with the truth summed in double.
double error_norm(const Image<float>& picture, const MemoryStack& stack,
                  const LightWeights& w) {
  const StackDims dims = stack.dims();
  double energy = 0.0;
  for (int c = 0; c < picture.channels(); ++c) {
    const int from = dims.channels == 1 ? 0 : c;
    for (int y = 0; y < dims.height; ++y) {
      for (int x = 0; x < dims.width; ++x) {
        double sum = 0.0;
        const float* row =
            stack.values().data() + ((static_cast<std::size_t>(from) * dims.n_pixels() +
                                      static_cast<std::size_t>(y * dims.width + x)) *
                                     static_cast<std::size_t>(dims.n_lights));
        for (int k = 0; k < dims.n_lights; ++k) {
          sum += w(k, w.cols() == 1 ? 0 : c) * double{row[k]};
        }
        const double off = double{picture(y, x, c)} - sum;
        energy += off * off;
      }
    }
  }
  return std::sqrt(energy);
}

TEST(DenseHalf, KeepsItsBound) {
  const MemoryStack& stack = make_stack({.channels = 3});
  const DenseHalf half(stack, "made");
  EXPECT_LT(half.report().relative_l2, 0x1p-11);
  EXPECT_GT(half.report().relative_l2, 0.0);
  const std::vector<LightWeights> all = {random_weights(1, 256), one_light(7, 256),
                                         random_weights(2, 256, 3)};
  const auto pictures = half.relight(all);
  for (std::size_t e = 0; e < all.size(); ++e) {
    const RelightBound& bound = pictures[e].bound;
    EXPECT_LE(error_norm(pictures[e].picture, stack, all[e]), bound.coded + bound.rounding);
    EXPECT_EQ(bound.dropped, 0.0);
    EXPECT_EQ(pictures[e].method, "dense half");
  }
}

TEST(DenseHalf, IntegersOfElevenBitsAreExact) {
  MemoryStack stack({5, 3, 1, 40});
  for (int x = 0; x < 5; ++x) {
    for (int k = 0; k < 40; ++k) {
      stack.at(0, 1, x, k) = static_cast<float>(
          hash_key(3, static_cast<std::uint64_t>(x), static_cast<std::uint64_t>(k)) % 2048);
    }
  }
  const DenseHalf half(stack, "made");
  EXPECT_EQ(half.report().relative_l2, 0.0);
  for (int k = 0; k < 40; ++k) {
    const std::vector<LightWeights> w = {one_light(k, 40)};
    const Image<float> picture = half.relight(w).front().picture;
    for (int x = 0; x < 5; ++x) {
      EXPECT_EQ(picture(1, x), stack.at(0, 1, x, k));
    }
  }
}

TEST(DenseHalf, SameBitsAloneInABatchAndOnAnyNumberOfThreads) {
  const MemoryStack& stack = make_stack({.width = 70});
  const DenseHalf half(stack, "made");
  std::vector<LightWeights> all;
  for (std::uint64_t e = 0; e < 11; ++e) {
    all.push_back(random_weights(e, 256));
  }
  const auto batch = half.relight(all);
  for (const int threads : {1, 2, 7}) {
    const ThreadLimit limit(threads);
    for (std::size_t e = 0; e < all.size(); ++e) {
      for (const KernelCode code : {KernelCode::portable, best_kernel_code()}) {
        const auto alone = half.relight(std::span(all).subspan(e, 1), code);
        EXPECT_TRUE(std::equal(alone[0].picture.pixels().begin(),
                               alone[0].picture.pixels().end(),
                               batch[e].picture.pixels().begin()));
        EXPECT_EQ(alone[0].bound.relative_l2, batch[e].bound.relative_l2);
      }
    }
  }
}

TEST(DenseHalf, ReusedMemoryHoldsNothingOfTheOldPicture) {
  const MemoryStack& stack = make_stack({});
  const DenseHalf half(stack, "made");
  const std::vector<LightWeights> w = {one_light(3, 256)};
  const std::vector<LightWeights> black = {LightWeights::Zero(256, 1)};
  const auto reused = half.relight(black, best_kernel_code(), half.relight(w));
  EXPECT_THAT(reused[0].picture.pixels(), testing::Each(0.0F));
}

TEST(DenseHalf, EmptyTilesAndDarkLightsAreNotRead) {
  MemoryStack stack({96, 32, 1, 256});  // three tiles; light falls on the middle one
  for (int k = 0; k < 256; ++k) {
    stack.at(0, 5, 40, k) = 1.0F + static_cast<float>(k);
  }
  const DenseHalf half(stack, "made");
  EXPECT_EQ(half.report().bytes, 32U * 32U * 256U * 2U);
  const std::vector<LightWeights> all = {LightWeights::Ones(256, 1)};
  EXPECT_EQ(half.relight(all)[0].bytes_read, half.report().bytes);
  const std::vector<LightWeights> one = {one_light(100, 256)};
  EXPECT_EQ(half.relight(one)[0].bytes_read, 32U * 32U * 32U * 2U);  // 32 lights of 256
  const std::vector<LightWeights> none = {LightWeights::Zero(256, 1)};
  EXPECT_EQ(half.relight(none)[0].bytes_read, 0U);
  EXPECT_EQ(half.relight(none)[0].bound.relative_l2, 0.0);
}

TEST(DenseHalf, RefusesMoreMemoryThanAllowedAndWrongWeights) {
  const MemoryStack& stack = make_stack({});
  EXPECT_THROW(DenseHalf(stack, "made", {.memory_bytes = 1000}), Error);
  const DenseHalf half(stack, "made");
  const std::vector<LightWeights> wrong = {LightWeights::Zero(255, 1)};
  EXPECT_THROW((void)half.relight(wrong), Error);
}

TEST(DenseHalf, TinyWeightsBesideLargeOnesStayInTheBound) {
  // The large weight meets black only: what is left is the tiny one's picture.
  MemoryStack stack({2, 2, 1, 2});
  stack.at(0, 1, 1, 1) = 3.0F;
  const DenseHalf half(stack, "made");
  for (const double tiny : {1e-6, 1e-15, 1e-30, 1e-45}) {
    LightWeights w(2, 1);
    w << 1.0, tiny;
    const std::vector<LightWeights> all = {w};
    const RelitPicture relit = half.relight(all).front();
    const RelightBound& bound = relit.bound;
    EXPECT_LE(error_norm(relit.picture, stack, w), bound.coded + bound.rounding) << tiny;
  }
}

}  // namespace
}  // namespace haarlight::relight
