// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/grey_jpeg.h"

#include <algorithm>
#include <vector>

#include "core/picture/jpeg.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {

bool decode_grey_jpeg(std::span<const std::byte> source, ImageView<std::uint16_t> words) {
  if (source.empty() || words.is_empty()) {
    return false;
  }
  try {
    JpegDecoder decoder(source);
    if (decoder.width() != words.width() || decoder.height() != words.height()) {
      return false;
    }
    decoder.start(1);
    std::vector<std::uint8_t> row(static_cast<std::size_t>(words.width()));
    for (int y = 0; y < words.height(); ++y) {
      decoder.read(row);
      std::copy(row.begin(), row.end(), words.row(y).begin());
    }
    decoder.finish();
  } catch (const JpegDamage&) {
    return false;
  }
  return true;
}

std::string encode_grey_jpeg(ImageView<const std::uint8_t> grey, int quality) {
  HAARLIGHT_EXPECTS(!grey.is_empty() && grey.channels() == 1, "a grey picture");
  return encode_jpeg({grey.height(), grey.width()},
                     JpegQuality{.channels = 1, .quality = quality, .has_own_tables = false},
                     "preview", [&](int y, std::span<std::uint8_t> samples) {
                       const auto row = grey.row(y);
                       std::copy(row.begin(), row.end(), samples.begin());
                     });
}

}  // namespace haarlight::capture
