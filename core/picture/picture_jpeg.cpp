// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <vector>

#include <fmt/format.h>

#include "core/picture/jpeg.h"
#include "core/picture/picture_formats.h"

namespace haarlight {

namespace {

PictureContent decode(const PictureSource& source, PictureWish wish) {
  JpegDecoder decoder(source.bytes);
  PictureContent content{.bits_per_sample = 8,
                         .is_floating = false,
                         .is_linear = false,
                         .tags = jpeg_tags(source.bytes)};
  const int channels = decoder.n_components();
  if (channels != 1 && channels != 3) {
    refuse_picture(source,
                   fmt::format("has {} colour components{}", channels,
                               channels == 4 ? ": CMYK, for print" : ""),
                   "give a grey or an RGB picture: convert it to sRGB first");
  }
  if (wish == PictureWish::header) {
    return content;
  }
  const auto width = static_cast<std::uint64_t>(decoder.width());
  const auto height = static_cast<std::uint64_t>(decoder.height());
  const std::uint64_t samples = width * height * static_cast<std::uint64_t>(channels);
  // A multi-scan picture is held as 16-bit coefficients.
  const std::uint64_t raw_bytes = decoder.has_multiple_scans() ? 3 * samples : samples;
  require_room(source, width, height, static_cast<std::uint64_t>(channels), raw_bytes);
  decoder.start(channels);
  content.pixels = Image<float>(decoder.height(), decoder.width(), channels);
  std::vector<std::uint8_t> row(static_cast<std::size_t>(width) *
                                static_cast<std::size_t>(channels));
  const ImageView<float> pixels = content.pixels.view();
  for (int y = 0; y < pixels.height(); ++y) {
    decoder.read(row);
    std::transform(row.begin(), row.end(), pixels.row(y).begin(), unit_of<std::uint8_t>);
  }
  return content;
}

}  // namespace

PictureContent read_jpeg(const PictureSource& source, PictureWish wish) {
  try {
    return decode(source, wish);
  } catch (const JpegDamage& damage) {
    refuse_damaged(source, damage.what());
  }
}

}  // namespace haarlight
