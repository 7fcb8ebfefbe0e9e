// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "haarlight/core/image.h"

/// @file
/// Previews for display: an 8-bit grey picture as JPEG. Only the .cpp includes libjpeg.

namespace haarlight::capture {

/// @param quality  1 to 100
/// @throws Error(internal)  libjpeg failed
[[nodiscard]] std::string encode_grey_jpeg(ImageView<const std::uint8_t> grey,
                                           int quality = 85);

/// Decodes the luma of a JPEG picture, such as a motion JPEG frame (whose Huffman tables may be
/// missing), into words 0..255.
/// @return  false: not a JPEG, damaged, or not of the view's size
[[nodiscard]] bool decode_grey_jpeg(std::span<const std::byte> source,
                                    ImageView<std::uint16_t> words);

}  // namespace haarlight::capture
