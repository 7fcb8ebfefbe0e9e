// SPDX-License-Identifier: Apache-2.0
#include "core/picture/picture_claim.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <optional>
#include <string_view>
#include <utility>

namespace haarlight {

namespace {

// Deflate (PNG, EXR, TIFF) gives at most 1032 bytes per byte, LZW about 1400, JPEG 512 pixels.
// DWA codes runs of runs: a uniform picture may be ten times smaller.
constexpr std::uint64_t kMostOfDwa = 20000;

/// Reads numbers from anywhere in a file; past its end everything is 0.
class Bytes {
 public:
  explicit Bytes(std::span<const std::byte> bytes) : bytes_(bytes) {}

  [[nodiscard]] std::size_t size() const { return bytes_.size(); }
  [[nodiscard]] std::uint64_t at(std::size_t i) const {
    return i < bytes_.size() ? std::to_integer<std::uint64_t>(bytes_[i]) : 0;
  }
  [[nodiscard]] std::uint64_t little(std::size_t i, std::size_t n) const {
    std::uint64_t value = 0;
    for (std::size_t k = n; k-- > 0;) {
      value = value << 8U | at(i + k);
    }
    return value;
  }
  [[nodiscard]] std::uint64_t big(std::size_t i, std::size_t n) const {
    std::uint64_t value = 0;
    for (std::size_t k = 0; k < n; ++k) {
      value = value << 8U | at(i + k);
    }
    return value;
  }
  /// The text from `i` to the next 0; nothing where there is none.
  [[nodiscard]] std::optional<std::string_view> text(std::size_t i) const {
    const std::string_view all(reinterpret_cast<const char*>(bytes_.data()), bytes_.size());
    const std::size_t end = i < all.size() ? all.find('\0', i) : std::string_view::npos;
    return end == std::string_view::npos ? std::nullopt : std::optional(all.substr(i, end - i));
  }

 private:
  std::span<const std::byte> bytes_;
};

PictureClaim claim_of(std::uint64_t width, std::uint64_t height, std::uint64_t pixel_bytes) {
  // Sides are below 2^33 in every format here, so 2^33 * 2^20 * 1024 channels do not overflow
  // once a side is clamped to 2^20, which is refused anyway.
  constexpr std::uint64_t kSide = std::uint64_t{1} << 20U;
  return {width, height, std::min(width, kSide) * std::min(height, kSide) * pixel_bytes};
}

PictureClaim jpeg_claim(const Bytes& bytes) {
  std::size_t i = 2;
  while (i + 9 < bytes.size() && bytes.at(i) == 0xff) {
    const std::uint64_t marker = bytes.at(i + 1);
    if (marker == 0xff) {  // fill byte
      ++i;
      continue;
    }
    const bool is_frame =
        marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc;
    if (is_frame) {
      return claim_of(bytes.big(i + 7, 2), bytes.big(i + 5, 2), bytes.at(i + 9));
    }
    if (marker == 0xd9 || marker == 0xda) {
      break;
    }
    i += 2 + bytes.big(i + 2, 2);
  }
  return {};
}

PictureClaim png_claim(const Bytes& bytes) {
  constexpr std::array<std::uint64_t, 7> kChannels{1, 1, 3, 1, 2, 1, 4};
  const std::uint64_t type = std::min<std::uint64_t>(bytes.at(25), kChannels.size() - 1);
  return claim_of(bytes.big(16, 4), bytes.big(20, 4),
                  kChannels[type] * (bytes.at(24) > 8 ? 2 : 1));
}

/// Does an attribute's value fill its size? OpenEXR parses these types by their own layout,
/// whatever the size says, so a wrong size would make it see a different header than we do.
bool fills_its_size(const Bytes& bytes, std::string_view type, std::size_t value,
                    std::uint64_t size) {
  constexpr std::array<std::pair<std::string_view, std::uint64_t>, 23> kSizes{
      {{"box2i", 16},
       {"box2f", 16},
       {"compression", 1},
       {"lineOrder", 1},
       {"float", 4},
       {"double", 8},
       {"int", 4},
       {"v2i", 8},
       {"v2f", 8},
       {"v2d", 16},
       {"v3i", 12},
       {"v3f", 12},
       {"v3d", 24},
       {"m33f", 36},
       {"m33d", 72},
       {"m44f", 64},
       {"m44d", 128},
       {"rational", 8},
       {"timecode", 8},
       {"keycode", 28},
       {"envmap", 1},
       {"tiledesc", 9},
       {"chromaticities", 32}}};
  for (const auto& [name, expected] : kSizes) {
    if (type == name) {
      return size == expected;
    }
  }
  const std::uint64_t end = value + size;
  if (type == "preview") {
    const std::uint64_t pixels =
        claim_of(bytes.little(value, 4), bytes.little(value + 4, 4), 1).raw_bytes;
    return size == 8 + 4 * pixels;
  }
  std::uint64_t at = value;
  if (type == "stringvector") {
    while (at < end) {
      at += 4 + bytes.little(static_cast<std::size_t>(at), 4);
    }
    return at == end;
  }
  if (type == "chlist") {
    while (at < end && bytes.at(static_cast<std::size_t>(at)) != 0) {
      const auto channel = bytes.text(static_cast<std::size_t>(at));
      at += channel ? channel->size() + 17 : size;
    }
    return at + 1 == end;
  }
  return true;
}

/// The largest of all parts of the file.
PictureClaim exr_claim(const Bytes& bytes) {
  const bool has_parts = (bytes.little(4, 4) & 0x1000U) != 0;
  PictureClaim largest;
  std::size_t i = 8;
  while (i < bytes.size() && bytes.at(i) != 0) {
    std::uint64_t width = 0;
    std::uint64_t height = 0;
    std::uint64_t pixel_bytes = 0;
    std::uint64_t tile_pixels = 0;
    std::uint64_t compression = 0;
    while (i < bytes.size() && bytes.at(i) != 0) {
      const auto name = bytes.text(i);
      const auto type = name ? bytes.text(i + name->size() + 1) : std::nullopt;
      if (!type) {
        return {.is_cut = true};
      }
      const std::size_t value = i + name->size() + type->size() + 6;
      const std::uint64_t size = bytes.little(value - 4, 4);
      if (value + size > bytes.size() || !fills_its_size(bytes, *type, value, size)) {
        return {.is_cut = true};  // OpenEXR would allocate memory for the value first
      }
      if (*name == "dataWindow") {
        const auto side = [&](std::size_t from) {
          const auto low = static_cast<std::int32_t>(bytes.little(value + from, 4));
          const auto high = static_cast<std::int32_t>(bytes.little(value + from + 8, 4));
          return static_cast<std::uint64_t>(
              std::max<std::int64_t>(std::int64_t{high} - low + 1, 0));
        };
        width = side(0);
        height = side(4);
      } else if (*name == "channels") {
        // name, 0, type (1: half), linear, two samplings
        std::size_t at = value;
        while (at < value + size && bytes.at(at) != 0) {
          const auto channel = bytes.text(at);
          if (!channel) {
            return {.is_cut = true};
          }
          pixel_bytes += bytes.little(at + channel->size() + 1, 4) == 1 ? 2 : 4;
          at += channel->size() + 17;
        }
      } else if (*name == "tiles") {
        tile_pixels = claim_of(bytes.little(value, 4), bytes.little(value + 4, 4), 1).raw_bytes;
      } else if (*name == "compression") {
        compression = bytes.at(value);
      }
      i = value + size;
    }
    ++i;  // past this part's attributes
    pixel_bytes = std::clamp<std::uint64_t>(pixel_bytes, 1, 4096);
    constexpr std::array<std::uint64_t, 10> kRows{1, 1, 1, 16, 32, 16, 32, 32, 32, 256};
    const std::uint64_t rows = tile_pixels > 0 || compression >= kRows.size()
                                   ? 1
                                   : kRows[static_cast<std::size_t>(compression)];
    PictureClaim claim = claim_of(width, height, pixel_bytes);
    claim.raw_bytes = std::max({claim.raw_bytes, claim_of(width, rows, pixel_bytes).raw_bytes,
                                tile_pixels * pixel_bytes});
    claim.most_per_byte = compression >= 8 ? kMostOfDwa : claim.most_per_byte;
    if (claim.raw_bytes >= largest.raw_bytes) {
      largest = claim;
    }
    if (!has_parts) {
      break;
    }
  }
  return largest;
}

/// "-Y 512 +X 1024" after the first empty line.
PictureClaim hdr_claim(std::span<const std::byte> bytes) {
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  const std::size_t head = text.find("\n\n");
  if (head == std::string_view::npos) {
    return {};
  }
  const std::string_view line = text.substr(head + 2, text.find('\n', head + 2) - head - 2);
  const auto number_after = [line](char axis) {
    std::uint64_t value = 0;
    const std::size_t at = line.find(axis);
    if (at != std::string_view::npos && at + 2 < line.size()) {
      std::from_chars(line.data() + at + 2, line.data() + line.size(), value);
    }
    return std::min(value, std::uint64_t{1} << 32U);
  };
  return claim_of(number_after('X'), number_after('Y'), 4);
}

}  // namespace

PictureClaim picture_claim(PictureFormat format, std::span<const std::byte> bytes) {
  const Bytes reader(bytes);
  switch (format) {
    case PictureFormat::jpeg:
      return jpeg_claim(reader);
    case PictureFormat::png:
      return png_claim(reader);
    case PictureFormat::openexr:
      return exr_claim(reader);
    case PictureFormat::hdr:
      return hdr_claim(bytes);
    case PictureFormat::targa:
      return claim_of(reader.little(12, 2), reader.little(14, 2), (reader.at(16) + 7) / 8);
    case PictureFormat::tiff:
    case PictureFormat::raw:
      break;
  }
  return {};
}

}  // namespace haarlight
