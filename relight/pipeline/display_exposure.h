// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

/// @file
/// Exposure for showing a linear picture.

namespace haarlight::relight {

/// The factor that makes this fraction of the values 1 or less; 1 for no values or a black
/// picture.
/// @param fraction  in [0, 1]
[[nodiscard]] double display_exposure(std::span<const float> values, double fraction);

/// Default of --exposure for a .png.
inline constexpr double kDisplayFraction = 0.995;

}  // namespace haarlight::relight
