// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <random>

/// @file
/// What a test takes from the environment: how much it does, and its random seed.

namespace haarlight::testing {

/// The variable's number; `otherwise` where it is not set.
[[nodiscard]] inline std::uint64_t number_from(const char* variable, std::uint64_t otherwise) {
  const char* text = std::getenv(variable);
  return text == nullptr ? otherwise : std::strtoull(text, nullptr, 10);
}

/// Another one in each run, printed; HAARLIGHT_SEED=n replays one.
[[nodiscard]] inline std::uint64_t drawn_seed() {
  const std::uint64_t seed = number_from("HAARLIGHT_SEED", std::random_device{}());
  std::printf("HAARLIGHT_SEED=%llu\n", static_cast<unsigned long long>(seed));
  return seed;
}

}  // namespace haarlight::testing
