// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/plate/counted_rank.h"

#include <algorithm>
#include <bit>
#include <limits>

#include "haarlight/core/error.h"
#include "relight/basis/by_kernel.h"

namespace haarlight::relight {

namespace {

constexpr auto kMostKey = std::numeric_limits<std::int32_t>::max();

/// A float as a whole number of the same order, and back: the same operation.
[[gnu::always_inline]] inline std::int32_t flip(std::int32_t bits) {
  return bits ^ ((bits >> 31) & kMostKey);
}

struct Ends {
  std::int32_t least = kMostKey;
  std::int32_t greatest = std::numeric_limits<std::int32_t>::min();
};

struct FillKeys {
  [[gnu::always_inline]] static inline Ends run(const float* __restrict values, std::size_t n,
                                                std::int32_t* __restrict keys) {
    std::int32_t least = kMostKey;
    std::int32_t greatest = std::numeric_limits<std::int32_t>::min();
    for (std::size_t k = 0; k < n; ++k) {
      const std::int32_t key = flip(std::bit_cast<std::int32_t>(values[k]));
      keys[k] = key;
      least = key < least ? key : least;
      greatest = greatest < key ? key : greatest;
    }
    return {least, greatest};
  }
};

struct CountTo {
  [[gnu::always_inline]] static inline std::int32_t run(const std::int32_t* keys, std::size_t n,
                                                        std::int32_t limit) {
    std::int32_t found = 0;
    for (std::size_t k = 0; k < n; ++k) {
      found += keys[k] <= limit ? 1 : 0;
    }
    return found;
  }
};

/// The greatest that is not above the limit.
struct GreatestTo {
  [[gnu::always_inline]] static inline std::int32_t run(const std::int32_t* keys, std::size_t n,
                                                        std::int32_t limit) {
    constexpr std::int32_t kLeast = std::numeric_limits<std::int32_t>::min();
    std::int32_t found = kLeast;
    for (std::size_t k = 0; k < n; ++k) {  // by masks: of a choice compilers make no vectors
      const std::int32_t is_above = keys[k] > limit ? -1 : 0;
      const std::int32_t key = (keys[k] & ~is_above) | (kLeast & is_above);
      found = found < key ? key : found;
    }
    return found;
  }
};

/// Keys [low, high] among which the rank lies: n_below are less than low, n_to at most high.
struct Bracket {
  std::int64_t low = 0;
  std::int64_t high = 0;
  std::size_t n_below = 0;
  std::size_t n_to = 0;
};

}  // namespace

float CountedRank::find(std::span<const float> values, std::size_t rank) {
  HAARLIGHT_EXPECTS(rank < values.size(), "a rank among the values");
  const std::size_t n = values.size();
  keys_.resize(n);
  const Ends ends = run_by_kernel<FillKeys>(values.data(), n, keys_.data());
  Bracket in{ends.least, ends.greatest, 0, n};
  const auto cut_at = [&](std::int64_t guess) {
    const auto n_to = static_cast<std::size_t>(
        run_by_kernel<CountTo>(keys_.data(), n, static_cast<std::int32_t>(guess)));
    if (n_to > rank) {
      in.high = guess;
      in.n_to = n_to;
    } else {
      in.low = guess + 1;
      in.n_below = n_to;
    }
  };
  // From the last row's value outwards, until the rank is between two guesses.
  constexpr std::int64_t kFirstWidth = std::int64_t{1} << 16U;  // 0.4 to 0.8 % of a value
  std::int64_t width = kFirstWidth;
  if (last_ >= in.low && last_ < in.high) {
    cut_at(last_);
    const bool is_below = in.high == last_;
    while (in.high - in.low > width) {
      const std::int64_t low = in.low;
      const std::int64_t high = in.high;
      cut_at(is_below ? high - width : low + width);
      if (is_below ? in.low != low : in.high != high) {
        break;
      }
      width *= 8;
    }
  }
  for (bool halves = false; in.low < in.high; halves = !halves) {
    if (in.n_to == rank + 1) {  // the greatest of the bracket
      in.low = in.high =
          run_by_kernel<GreatestTo>(keys_.data(), n, static_cast<std::int32_t>(in.high));
      break;
    }
    // By turns where the rank would lie if they were evenly spread, and in the middle.
    const double part = halves ? 0.5
                               : (static_cast<double>(rank - in.n_below) + 0.5) /
                                     static_cast<double>(in.n_to - in.n_below);
    const auto step = static_cast<std::int64_t>(part * static_cast<double>(in.high - in.low));
    cut_at(in.low + std::min(step, in.high - in.low - 1));
  }
  last_ = static_cast<std::int32_t>(in.low);
  return std::bit_cast<float>(flip(last_));
}

}  // namespace haarlight::relight
