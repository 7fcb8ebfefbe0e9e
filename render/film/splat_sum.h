// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <bit>
#include <cmath>
#include <cstdint>

#include <Eigen/Core>

#include "haarlight/core/error.h"

/// @file
/// Sums whose bits do not depend on the order in which they are made: fixed-point numbers of 96
/// bits, each pixel's about the largest value that it got, as in the indexed sums of [Demmel15].

namespace haarlight::render {

/// The sum of three numbers each. Positions are absolute: position p counts multiples of 2^(32 p). The
/// three uppermost that any value has reached are kept. A value is cut at the borders of positions,
/// which does not depend on what came before; what is below the three is dropped, less than 2^-64
/// of the largest value each time.
class SplatSum {
 public:
  /// @param value  finite
  /// @throws Error  values beyond 2^928 (10^279), more than 10^9 in one pixel: not in silence
  void add(const Eigen::Vector3d& value) {
    const double most = value.cwiseAbs().maxCoeff();
    if (!(most > 0.0)) {
      return;
    }
    raise(position_of(most));
    for (int c = 0; c < 3; ++c) {
      double rest = value[c];
      for (int i = 0; i < kWords; ++i) {
        const double slice = std::trunc(rest * two_to(kBits * (i - top())));
        rest -= slice * two_to(kBits * (top() - i));
        word(i, c) = within(word(i, c) + static_cast<std::int64_t>(slice));
      }
    }
  }

  void add(const SplatSum& other) {
    SplatSum raised = other;
    raise(other.top_);
    raised.raise(top_);
    for (std::size_t i = 0; i < words_.size(); ++i) {
      words_[i] = within(words_[i] + raised.words_[i]);
    }
  }

  [[nodiscard]] Eigen::Vector3d value() const {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (int i = kWords - 1; i >= 0; --i) {
      for (int c = 0; c < 3; ++c) {
        sum[c] += static_cast<double>(words_[index_of(i, c)]) * two_to(kBits * (top() - i));
      }
    }
    return sum;
  }

  /// Whether its numbers can be those of a sum: of one that has been read from a file.
  [[nodiscard]] bool is_possible() const {
    bool is_small = top_ >= kLowest && top_ <= kHighest;
    for (const std::int64_t word : words_) {
      is_small = is_small && word > -kMost && word < kMost;
    }
    return is_small;
  }

 private:
  static constexpr int kBits = 32;  // of a position
  static constexpr int kWords = 3;
  static constexpr int kLowest = -26;  // top position: powers of two stay normal numbers
  static constexpr int kHighest = 28;
  static constexpr std::int64_t kMost = std::int64_t{1} << 62U;

  static double two_to(int exponent) {
    return std::bit_cast<double>(static_cast<std::uint64_t>(1023 + exponent) << 52U);
  }
  static constexpr std::size_t index_of(int i, int c) {
    return 3 * static_cast<std::size_t>(i) + static_cast<std::size_t>(c);
  }
  std::int64_t& word(int i, int c) { return words_[index_of(i, c)]; }

  [[nodiscard]] int top() const { return static_cast<int>(top_); }

  static int position_of(double value) {
    const int exponent = static_cast<int>(std::bit_cast<std::uint64_t>(value) >> 52U) - 1023;
    return exponent >> 5;  // rounded down
  }

  static std::int64_t within(std::int64_t word) {
    if (!(word > -kMost && word < kMost)) {
      throw Error("light paths give a pixel more than its sum holds", "the film",
                  "render fewer samples");
    }
    return word;
  }

  void raise(std::int64_t position) {
    if (position <= top_) {
      return;
    }
    if (position > kHighest) {
      throw Error("light paths are brighter than a film holds", "the film",
                  "scale the scene's lights down");
    }
    const auto by = static_cast<int>(position - top_);
    for (int i = kWords - 1; i >= 0; --i) {
      for (int c = 0; c < 3; ++c) {
        word(i, c) = i >= by ? word(i - by, c) : 0;
      }
    }
    top_ = position;
  }

  std::array<std::int64_t, std::size_t{3} * kWords> words_{};
  std::int64_t top_ = kLowest;
};

/// What light paths have sent to a pixel: the sum, and the sum of the squares.
struct SplatPixel {
  SplatSum light;
  SplatSum squares;
};

}  // namespace haarlight::render
