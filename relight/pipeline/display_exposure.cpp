// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/display_exposure.h"

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <vector>

namespace haarlight::relight {

namespace {

/// The upper half of a float's bits, in the order of the floats.
std::size_t half_of(float value) {
  const auto bits = std::bit_cast<std::uint32_t>(value);
  constexpr std::uint32_t kSign = 0x80000000U;
  return ((bits & kSign) != 0 ? ~bits : bits | kSign) >> 16U;
}

}  // namespace

double display_exposure(std::span<const float> values, double fraction) {
  if (values.empty()) {
    return 1.0;
  }
  // The value of that rank: counted by the upper halves, then sought among those of one half.
  auto rank = static_cast<std::size_t>(fraction * static_cast<double>(values.size() - 1));
  std::vector<std::uint32_t> counts(std::size_t{1} << 16U);
  for (const float value : values) {
    ++counts[half_of(value)];
  }
  std::size_t half = 0;
  for (; rank >= counts[half]; ++half) {
    rank -= counts[half];
  }
  std::vector<float> near;
  near.reserve(counts[half]);
  std::copy_if(values.begin(), values.end(), std::back_inserter(near),
               [half](float value) { return half_of(value) == half; });
  const auto at = near.begin() + static_cast<std::ptrdiff_t>(rank);
  std::nth_element(near.begin(), at, near.end());
  return *at > 0.0F ? 1.0 / static_cast<double>(*at) : 1.0;
}

}  // namespace haarlight::relight
