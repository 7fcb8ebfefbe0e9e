// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

/// @file
/// Counter-based random numbers: the value depends on the key alone, never on thread or order.

namespace haarlight {

/// A 64-bit hash of one key: the finaliser of SplitMix64 [Steele14].
[[nodiscard]] constexpr std::uint64_t mix_bits(std::uint64_t key) {
  key += 0x9e3779b97f4a7c15ULL;
  key = (key ^ (key >> 30)) * 0xbf58476d1ce4e5b9ULL;
  key = (key ^ (key >> 27)) * 0x94d049bb133111ebULL;
  return key ^ (key >> 31);
}

/// Of up to four keys: mix_bits, applied per key.
[[nodiscard]] constexpr std::uint64_t hash_key(std::uint64_t a, std::uint64_t b = 0,
                                               std::uint64_t c = 0, std::uint64_t d = 0) {
  return mix_bits(mix_bits(mix_bits(mix_bits(a) ^ b) ^ c) ^ d);
}

/// Uniform in [0, 1), 53 bits.
[[nodiscard]] constexpr double uniform_unit(std::uint64_t hash) {
  return static_cast<double>(hash >> 11) * 0x1p-53;
}

/// Standard normal from one hash (Box-Muller on its two halves; tails to 6.6 sigma).
[[nodiscard]] double standard_normal(std::uint64_t hash);

/// Poisson-distributed count of the given mean: exact by inversion below 30; above that the
/// rounded normal approximation, whose relative error in the variance is below 0.3 %.
[[nodiscard]] std::uint32_t poisson(double mean, std::uint64_t hash);

}  // namespace haarlight
