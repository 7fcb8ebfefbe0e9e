// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"

/// @file
/// Complex indices of refraction of metals at 650, 550 and 450 nm, taken as red, green and blue.

namespace haarlight::render {

enum class Metal : std::uint8_t { aluminium, copper, gold, silver };
inline constexpr auto kMetalWords =
    std::to_array<std::string_view>({"aluminium", "copper", "gold", "silver"});
constexpr std::span<const std::string_view> words_of(Metal) { return kMetalWords; }

/// eta + i k
struct ComplexIor {
  Eigen::Vector3d eta;
  Eigen::Vector3d k;
};

[[nodiscard]] ComplexIor ior_of(Metal metal);

}  // namespace haarlight::render
