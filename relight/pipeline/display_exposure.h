// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

/// @file
/// How bright a linear picture is shown.

namespace haarlight {

/// The factor that makes this share of the values 1 or less; 1 for no values or a black
/// picture.
/// @param share  in [0, 1]
[[nodiscard]] double display_exposure(std::vector<float> values, double share);

/// What --exposure leaves open for a .png.
inline constexpr double kDisplayShare = 0.995;

}  // namespace haarlight
