// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>

#include "core/image.h"

/// @file
/// Planes as JPEG pictures in memory, grey or R, G, B (stored as YCbCr, colours at full size).
/// Only the .cpp sees libjpeg.

namespace haarlight {

struct JpegShape {
  int height = 0;
  int width = 0;
};

/// The picture's size from its header alone; nothing is decoded.
/// @param where  names the picture, for messages
/// @throws Error  not a JPEG picture, or larger than `source` can possibly hold
[[nodiscard]] JpegShape jpeg_shape(std::string_view source, const std::string& where);

/// Takes row after row, top first: width * channels samples.
using TakeRow = std::function<void(int y, std::span<const std::uint8_t> samples)>;

/// Decodes to 1 (grey) or 3 (R, G, B) channels.
/// @throws Error  as jpeg_shape; also any damage, such as an end too early
void decode_jpeg(std::string_view source, int channels, const std::string& where,
                 const TakeRow& take);

/// Fills one row: width * channels samples.
using GiveRow = std::function<void(int y, std::span<std::uint8_t> samples)>;

/// How to code a three-channel picture whose values are not perceptual colours: one
/// quantisation step for all frequencies, the least squared error that JPEG offers for its
/// bytes.
struct JpegSteps {
  bool is_ycc = false;               ///< code Y, Cb, Cr instead of R, G, B directly
  std::array<int, 3> step{1, 1, 1};  ///< of each of the three, 1 to 255
};

/// @throws Error  as below
[[nodiscard]] std::string encode_jpeg(JpegShape shape, const JpegSteps& steps,
                                      const std::string& where, const GiveRow& give);

/// @param quality  1 to 100
/// @param channels 1 (grey) or 3 (R, G, B; 4:4:4)
/// @throws Error  beyond JPEG's 65500 pixels per side, or libjpeg refused
[[nodiscard]] std::string encode_jpeg(JpegShape shape, int channels, int quality,
                                      const std::string& where, const GiveRow& give);

}  // namespace haarlight
