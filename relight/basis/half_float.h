// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <bit>
#include <cstdint>

/// @file
/// IEEE 754 binary16 as storage: 11 significant bits, normal from 2^-14 to 65504, steps of
/// 2^-24 below. Never an accumulator: docs/numerics/relight.md, "Kernels". Pure.

namespace haarlight::relight {

inline constexpr float kLargestHalf = 65504.0F;

/// Exact. Infinities and NaN are not stored here and not handled.
[[nodiscard]] inline float half_to_float(std::uint16_t half) noexcept {
  const std::uint32_t magnitude = (half & 0x7fffU) << 13U;
  const std::uint32_t sign = (half & 0x8000U) << 16U;
  // 2^112 moves the exponent's bias from 15 to 127; subnormals come out right automatically.
  const float value = std::bit_cast<float>(magnitude) * 0x1p112F;
  return std::bit_cast<float>(std::bit_cast<std::uint32_t>(value) | sign);
}

/// To the nearest half, ties to even: off by at most max(2^-11 |value|, 2^-25).
/// @param value  |value| <= kLargestHalf
[[nodiscard]] inline std::uint16_t float_to_half(float value) noexcept {
  constexpr std::uint32_t kSmallestNormal = 0x38800000U;  // 2^-14
  const auto bits = std::bit_cast<std::uint32_t>(value);
  const std::uint32_t magnitude = bits & 0x7fffffffU;
  // Both are computed, so that a loop over values has no branch. In [0.5, 1) a float's last bit is
  // 2^-24, a subnormal half's step: the addition rounds.
  const std::uint32_t subnormal =
      std::bit_cast<std::uint32_t>(std::bit_cast<float>(magnitude) + 0.5F) -
      std::bit_cast<std::uint32_t>(0.5F);
  const std::uint32_t normal =
      (magnitude + 0xfffU + ((magnitude >> 13U) & 1U) - (112U << 23U)) >> 13U;
  const std::uint32_t half = magnitude < kSmallestNormal ? subnormal : normal;
  return static_cast<std::uint16_t>(half | ((bits >> 16U) & 0x8000U));
}

}  // namespace haarlight::relight
