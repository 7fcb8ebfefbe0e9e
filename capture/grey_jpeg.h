#pragma once

#include <cstdint>
#include <string>

#include "core/image.h"

/// @file
/// Previews for people: an 8-bit grey picture as JPEG. Only the .cpp sees libjpeg.

namespace haarlight {

/// @param quality  1 to 100
/// @throws Error(internal)  libjpeg refused
[[nodiscard]] std::string encode_grey_jpeg(ImageView<const std::uint8_t> grey,
                                           int quality = 85);

}  // namespace haarlight
