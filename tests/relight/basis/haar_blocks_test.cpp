// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/haar_blocks.h"

#include <cstring>
#include <vector>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/basis/haar.h"

namespace haarlight::relight {
namespace {

template <class T>
std::vector<T> random_values(std::size_t n) {
  std::vector<T> values(n);
  for (std::size_t i = 0; i < n; ++i) {
    values[i] = static_cast<T>(2.0 * uniform_unit(hash_key(11, i)) - 1.0);
  }
  return values;
}

template <class T>
bool has_same_bits(const std::vector<T>& a, const std::vector<T>& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0;
}

/// Array by array with haar.h.
template <class T>
std::vector<T> one_by_one(std::vector<T> values, int n, bool is_forward) {
  const std::size_t size = static_cast<std::size_t>(n) * static_cast<std::size_t>(n);
  for (std::size_t at = 0; at < values.size(); at += size) {
    const std::span<T> array = std::span(values).subspan(at, size);
    is_forward ? haar_forward(array, HaarGrid{n, n}) : haar_inverse(array, HaarGrid{n, n});
  }
  return values;
}

template <class T>
void expect_same_bits(int n, std::size_t n_arrays) {
  const auto in = random_values<T>(n_arrays * static_cast<std::size_t>(n * n));
  std::vector<T> values = in;
  haar_forward_blocks(std::span(values), {n, n});
  EXPECT_TRUE(has_same_bits(values, one_by_one(in, n, true))) << n << ' ' << n_arrays;
  values = in;
  haar_inverse_blocks(std::span(values), {n, n});
  EXPECT_TRUE(has_same_bits(values, one_by_one(in, n, false))) << n << ' ' << n_arrays;
}

TEST(HaarBlocks, GiveTheBitsOfTheTransformOfOneArray) {
  for (const int n : {1, 2, 4, 8, 16, 32, 64, 128}) {
    expect_same_bits<float>(n, 5);
    expect_same_bits<double>(n, 5);
  }
}

TEST(HaarBlocks, GiveThemPastTheCachesTooOnAnyNumberOfThreads) {
  for (const int threads : {1, 2, 7}) {
    const ThreadLimit limit(threads);
    expect_same_bits<float>(32, 2100);  // 8.6 MB
  }
}

TEST(HaarBlocks, RefuseOtherSizes) {
  std::vector<float> values(64);
  EXPECT_THROW(haar_forward_blocks(std::span(values), {0, 3}), ContractViolation);
  EXPECT_THROW(haar_forward_blocks(std::span(values), {16, 16}), ContractViolation);
  EXPECT_THROW(haar_forward_blocks(std::span(values).first(40), {4, 4}), ContractViolation);
}

TEST(HaarBlocks, OfUnbalancedGridsAreThoseOfOneArray) {
  const HaarGrid grid{17, 30};
  auto values = random_values<float>(1000 * static_cast<std::size_t>(grid.size()));
  std::vector<float> one = values;
  haar_forward(std::span(one), grid);
  haar_forward_blocks(std::span(values), grid);
  EXPECT_TRUE(has_same_bits(values, one));
  haar_inverse_blocks(std::span(values), grid);
  haar_inverse(std::span(one), grid);
  EXPECT_TRUE(has_same_bits(values, one));
}

}  // namespace
}  // namespace haarlight::relight
