// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"

/// @file
/// The numbers that a picture's samples are made of, in [0, 1). Each depends on the seed, the
/// pixel, the sample and the dimension alone: any tile, thread or part of a picture that asks
/// again gets the same.
///
/// A dimension is a question: where in the pixel, which light, which direction at the third
/// bounce. One question may ask for one number or for a pair; pairs are well spread in the
/// square, different dimensions are independent.

namespace haarlight::render {

enum class SamplerKind : std::uint8_t {
  independent,  ///< by a hash [Steele14]: the baseline
  stratified,  ///< each 16 samples in turn: one in each sixteenth of the line or square, in no order
  halton,  ///< radical inverses [Halton60] in a pair of primes for each dimension, Owen-scrambled
  sobol,  ///< a dimension's points of all samples are a (0, 2)-sequence, Owen-scrambled [Burley20]
};
inline constexpr auto kSamplerWords =
    std::to_array<std::string_view>({"independent", "stratified", "halton", "sobol"});
constexpr std::span<const std::string_view> words_of(SamplerKind) { return kSamplerWords; }

/// The samples of one pixel.
class PixelSamples {
 public:
  PixelSamples(SamplerKind kind, std::uint64_t seed, int x, int y);

  /// @param sample, dimension  from 0
  [[nodiscard]] double one(std::uint32_t sample, std::uint32_t dimension) const;
  [[nodiscard]] Eigen::Vector2d two(std::uint32_t sample, std::uint32_t dimension) const;

  /// `two` of many pixels, which all have the kind of the first: the same numbers, sooner.
  /// @param squares  (pixels.size(),)
  static void two(std::span<const PixelSamples> pixels, std::uint32_t sample,
                  std::uint32_t dimension, std::span<Eigen::Vector2d> squares);

 private:
  SamplerKind kind_;
  std::uint64_t pixel_;
};

/// The radical inverse of an index in a prime base, nested scrambling of its digits [Owen95]: each
/// goes through d -> a d + c modulo the base, a and c random and by the digits before it. Any two
/// digits become any two others with the same probability, which is all that the variance of
/// Owen's scrambling depends on [Matousek98].
[[nodiscard]] double scrambled_radical_inverse(std::uint32_t base, std::uint64_t index,
                                               std::uint64_t seed);

}  // namespace haarlight::render
