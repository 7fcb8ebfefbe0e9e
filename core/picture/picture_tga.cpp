// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <string_view>
#include <vector>

#include <fmt/format.h>

#include "core/picture/picture_formats.h"

/// @file
/// TGA. Source: Truevision TGA file format specification, version 2.0 (1991).

namespace haarlight {

namespace {

using Rgb = std::array<std::uint8_t, 3>;

struct TgaHeader {
  std::size_t id_length = 0;
  bool has_map = false;
  int type = 0;
  std::size_t map_first = 0;
  std::size_t map_length = 0;
  int map_bits = 0;
  int width = 0;
  int height = 0;
  int bits = 0;
  bool is_right_to_left = false;
  bool is_top_down = false;

  [[nodiscard]] bool is_coded() const { return type >= 9; }
  [[nodiscard]] bool is_palette() const { return type % 8 == 1; }
  [[nodiscard]] bool is_grey() const { return type % 8 == 3; }
  [[nodiscard]] int channels() const { return is_grey() ? 1 : 3; }
  /// 15-bit pixels occupy 16.
  [[nodiscard]] std::size_t pixel_bytes() const {
    return static_cast<std::size_t>((bits + 7) / 8);
  }
  [[nodiscard]] std::size_t map_entry_bytes() const {
    return static_cast<std::size_t>((map_bits + 7) / 8);
  }
};

std::size_t little(std::span<const std::byte> bytes, std::size_t at, std::size_t n) {
  std::size_t value = 0;
  while (n-- > 0) {
    value = value << 8U | std::to_integer<std::size_t>(bytes[at + n]);
  }
  return value;
}

constexpr std::size_t kHeaderBytes = 18;

TgaHeader header_of(const PictureSource& source) {
  const std::span<const std::byte> bytes = source.bytes;
  const auto small = [&](std::size_t at) { return std::to_integer<int>(bytes[at]); };
  const TgaHeader header{.id_length = little(bytes, 0, 1),
                         .has_map = small(1) == 1,
                         .type = small(2),
                         .map_first = little(bytes, 3, 2),
                         .map_length = little(bytes, 5, 2),
                         .map_bits = small(7),
                         .width = static_cast<int>(little(bytes, 12, 2)),
                         .height = static_cast<int>(little(bytes, 14, 2)),
                         .bits = small(16),
                         .is_right_to_left = (small(17) & 0x10) != 0,
                         .is_top_down = (small(17) & 0x20) != 0};
  const auto is_one_of = [](int value, std::initializer_list<int> all) {
    return std::find(all.begin(), all.end(), value) != all.end();
  };
  const bool is_good = header.is_palette() ? header.has_map && is_one_of(header.bits, {8, 16})
                       : header.is_grey()  ? !header.has_map && is_one_of(header.bits, {8, 16})
                                           : is_one_of(header.bits, {15, 16, 24, 32});
  if (!is_good || (header.has_map && !is_one_of(header.map_bits, {15, 16, 24, 32}))) {
    refuse_picture(source,
                   fmt::format("a TGA of type {} with {} bits per pixel, {} per colour",
                               header.type, header.bits, header.map_bits),
                   "not a TGA, or one that is not read: save it as PNG");
  }
  return header;
}

/// The extension area of version 2 says that the values are linear: gamma 1.
bool says_linear(std::span<const std::byte> bytes) {
  constexpr std::string_view kSignature = "TRUEVISION-XFILE.";
  constexpr std::size_t kFooterBytes = 26;
  constexpr std::size_t kExtensionBytes = 495;
  constexpr std::size_t kGammaAt = 478;
  if (bytes.size() < kHeaderBytes + kFooterBytes) {
    return false;
  }
  const std::size_t footer = bytes.size() - kFooterBytes;
  if (std::memcmp(&bytes[footer + 8], kSignature.data(), kSignature.size()) != 0) {
    return false;
  }
  const std::size_t at = little(bytes, footer, 4);
  if (at == 0 || at + kExtensionBytes > bytes.size() ||
      little(bytes, at, 2) < kExtensionBytes) {
    return false;
  }
  const auto numerator = static_cast<double>(little(bytes, at + kGammaAt, 2));
  const auto denominator = static_cast<double>(little(bytes, at + kGammaAt + 2, 2));
  return denominator > 0.0 && std::lround(100.0 * numerator / denominator) == 100;
}

/// Walks over the pixels in the file's order; refuses to read past its end.
class TgaPixels {
 public:
  TgaPixels(const PictureSource& source, const TgaHeader& header)
      : source_(source), header_(header), at_(kHeaderBytes + header.id_length) {
    if (header_.has_map) {
      const std::size_t n = header_.map_entry_bytes();
      require(n * header_.map_length);
      for (std::size_t i = 0; i < header_.map_length; ++i) {
        map_.push_back(colour(at_ + i * n, n));
      }
      at_ += n * header_.map_length;
    }
  }

  Rgb next() {
    if (!header_.is_coded()) {
      return read();
    }
    if (n_left_ == 0) {
      require(1);
      const auto code = std::to_integer<unsigned>(source_.bytes[at_++]);
      n_left_ = (code & 0x7fU) + 1;
      is_run_ = (code & 0x80U) != 0;
      pixel_ = read();
    } else if (!is_run_) {
      pixel_ = read();
    }
    --n_left_;
    return pixel_;
  }

 private:
  void require(std::size_t n) const {
    if (at_ > source_.bytes.size() || n > source_.bytes.size() - at_) {
      refuse_damaged(source_, "it ends before the picture does");
    }
  }

  Rgb read() {
    const std::size_t n = header_.pixel_bytes();
    require(n);
    const std::size_t at = at_;
    at_ += n;
    if (header_.is_grey()) {
      return {std::to_integer<std::uint8_t>(source_.bytes[at])};
    }
    if (!header_.is_palette()) {
      return colour(at, n);
    }
    const std::size_t entry = little(source_.bytes, at, n) - header_.map_first;
    if (entry >= map_.size()) {  // an index below the first entry wraps around
      refuse_damaged(source_, "a pixel's colour is not in the palette");
    }
    return map_[entry];
  }

  /// Blue first; two-byte pixels have five bits each.
  [[nodiscard]] Rgb colour(std::size_t at, std::size_t n) const {
    if (n == 2) {
      const std::size_t word = little(source_.bytes, at, 2);
      const auto five = [&](unsigned shift) {
        const std::size_t value = word >> shift & 31U;
        return static_cast<std::uint8_t>(value << 3U | value >> 2U);
      };
      return {five(10), five(5), five(0)};
    }
    const auto byte = [&](std::size_t i) {
      return std::to_integer<std::uint8_t>(source_.bytes[at + i]);
    };
    return {byte(2), byte(1), byte(0)};
  }

  const PictureSource& source_;
  const TgaHeader& header_;
  std::size_t at_;
  std::vector<Rgb> map_;
  unsigned n_left_ = 0;
  bool is_run_ = false;
  Rgb pixel_{};
};

}  // namespace

PictureContent read_tga(const PictureSource& source, PictureWish wish) {
  const TgaHeader header = header_of(source);
  PictureContent content{
      .bits_per_sample = 8, .is_floating = false, .is_linear = says_linear(source.bytes)};
  if (wish == PictureWish::header) {
    return content;
  }
  const auto width = static_cast<std::uint64_t>(header.width);
  const auto height = static_cast<std::uint64_t>(header.height);
  require_room(source, width, height, static_cast<std::uint64_t>(header.channels()),
               width * height * header.pixel_bytes());
  content.pixels = Image<float>(header.height, header.width, header.channels());
  TgaPixels pixels(source, header);
  for (int row = 0; row < header.height; ++row) {
    const int y = header.is_top_down ? row : header.height - 1 - row;
    for (int column = 0; column < header.width; ++column) {
      const int x = header.is_right_to_left ? header.width - 1 - column : column;
      const Rgb pixel = pixels.next();
      for (int c = 0; c < header.channels(); ++c) {
        content.pixels(y, x, c) = unit_of(pixel[static_cast<std::size_t>(c)]);
      }
    }
  }
  return content;
}

}  // namespace haarlight
