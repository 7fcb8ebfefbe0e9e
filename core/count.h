// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

namespace haarlight {

/// A number of things as the standard library counts them.
/// @param n  >= 0
[[nodiscard]] constexpr std::size_t count(int n) { return static_cast<std::size_t>(n); }

}  // namespace haarlight
