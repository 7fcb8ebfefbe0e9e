// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>

/// @file
/// A tile of three 8-bit planes as a PNG picture in memory. [ISO 15948]

namespace haarlight {

/// Fills one row: 3 * width samples R, G, B.
using GiveTileRow = std::function<void(int y, std::span<std::uint8_t> samples)>;

/// Lossless; the same samples give the same bytes. Without a colour profile or gamma: a browser
/// told not to convert returns the samples unchanged.
/// @throws Error(internal)  libpng refused
[[nodiscard]] std::string encode_png(int height, int width, const GiveTileRow& give);

}  // namespace haarlight
