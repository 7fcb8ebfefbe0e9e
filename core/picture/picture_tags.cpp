// SPDX-License-Identifier: Apache-2.0
#include "core/picture/picture_tags.h"

#include <algorithm>
#include <cctype>
#include <cstdint>
#include <cstring>
#include <map>
#include <string>

#include <zlib.h>

namespace haarlight {

namespace {

using namespace std::string_view_literals;

std::string_view text_of(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

std::vector<std::byte> bytes_of(std::string_view text) {
  const auto* first = reinterpret_cast<const std::byte*>(text.data());
  return {first, first + text.size()};
}

std::uint32_t big(std::string_view bytes, std::size_t at, std::size_t n) {
  std::uint32_t value = 0;
  for (std::size_t i = at; i < at + n; ++i) {
    value = value << 8U | (i < bytes.size() ? static_cast<unsigned char>(bytes[i]) : 0U);
  }
  return value;
}

/// EXIF's numbers, in its byte order; past its end everything is 0.
class ExifBlock {
 public:
  explicit ExifBlock(std::string_view bytes)
      : bytes_(bytes), is_big_(bytes.starts_with("MM")) {}

  struct Entry {
    unsigned type = 0;
    std::size_t count = 0;
    std::size_t value_at = 0;
  };

  [[nodiscard]] bool is_good() const {
    return bytes_.starts_with("II*\0"sv) || bytes_.starts_with("MM\0*"sv);
  }
  [[nodiscard]] std::uint32_t number(std::size_t at, std::size_t n) const {
    if (is_big_) {
      return big(bytes_, at, n);
    }
    std::uint32_t value = 0;
    for (std::size_t i = n; i-- > 0;) {
      value = value << 8U | big(bytes_, at + i, 1);
    }
    return value;
  }
  [[nodiscard]] std::optional<Entry> find(std::size_t directory, unsigned tag) const {
    if (directory == 0 || directory >= bytes_.size()) {
      return std::nullopt;
    }
    const std::size_t n = number(directory, 2);
    for (std::size_t i = 0; i < n; ++i) {
      const std::size_t at = directory + 2 + 12 * i;
      if (at + 12 > bytes_.size()) {
        break;
      }
      if (number(at, 2) != tag) {
        continue;
      }
      constexpr std::array<std::size_t, 13> kSizes{0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8};
      const Entry entry{number(at + 2, 2), number(at + 4, 4), 0};
      const std::size_t size =
          (entry.type < kSizes.size() ? kSizes[entry.type] : 0) * entry.count;
      const std::size_t value_at = size <= 4 ? at + 8 : number(at + 8, 4);
      if (size == 0 || value_at > bytes_.size() || size > bytes_.size() - value_at) {
        return std::nullopt;
      }
      return Entry{entry.type, entry.count, value_at};
    }
    return std::nullopt;
  }
  [[nodiscard]] std::optional<std::uint32_t> integer(std::size_t directory,
                                                     unsigned tag) const {
    const auto entry = find(directory, tag);
    if (!entry || (entry->type != 3 && entry->type != 4)) {
      return std::nullopt;
    }
    return number(entry->value_at, entry->type == 3 ? 2 : 4);
  }
  /// A camera's number.
  [[nodiscard]] std::optional<double> quotient(std::size_t directory, unsigned tag) const {
    const auto entry = find(directory, tag);
    if (!entry || entry->type != 5) {
      return std::nullopt;
    }
    const double above = number(entry->value_at, 4);
    const double below = number(entry->value_at + 4, 4);
    return below > 0.0 ? camera_number(above / below) : std::nullopt;
  }
  /// Printable ASCII, at most 64 characters.
  [[nodiscard]] std::string text(std::size_t directory, unsigned tag) const {
    const auto entry = find(directory, tag);
    std::string result;
    for (std::size_t i = 0; entry && entry->type == 2 && i < std::min(entry->count, kMostText);
         ++i) {
      const char c = bytes_[entry->value_at + i];
      if (c == '\0') {
        break;
      }
      result += c >= ' ' && c <= '~' ? c : '?';
    }
    result.resize(result.find_last_not_of(' ') + 1);
    return result;
  }

 private:
  static constexpr std::size_t kMostText = 64;
  std::string_view bytes_;
  bool is_big_;
};

/// Inflates at most `most` bytes; empty if the data are invalid.
std::vector<std::byte> inflated(std::string_view data, std::size_t most) {
  std::vector<std::byte> out(std::min(most, 1100 * data.size() + 64));  // deflate's limit: 1032
  auto size = static_cast<uLongf>(out.size());
  if (uncompress(reinterpret_cast<Bytef*>(out.data()), &size,
                 reinterpret_cast<const Bytef*>(data.data()),
                 static_cast<uLong>(data.size())) != Z_OK) {
    return {};
  }
  out.resize(size);
  return out;
}

/// "\nexif\n      94\n45786966..." as ImageMagick and others write it into a PNG's text.
std::string from_hexadecimal(std::string_view text) {
  std::string result;
  const auto value = [](char c) {
    return c <= '9' ? c - '0' : std::tolower(static_cast<unsigned char>(c)) - 'a' + 10;
  };
  const std::size_t name = std::min(text.find("exif"), text.size());
  const std::size_t length = std::min(text.find_first_of("0123456789", name), text.size());
  std::size_t at = std::min(text.find('\n', length), text.size());  // the data follow
  int high = -1;
  for (; at < text.size(); ++at) {
    if (std::isxdigit(static_cast<unsigned char>(text[at])) == 0) {
      continue;
    }
    if (high < 0) {
      high = value(text[at]);
    } else {
      result += static_cast<char>(high * 16 + value(text[at]));
      high = -1;
    }
  }
  return result;
}

constexpr std::string_view kExifHead = "Exif\0\0"sv;

void take_exif(std::string_view exif, PictureTags& tags) {
  if (exif.starts_with(kExifHead)) {
    exif.remove_prefix(kExifHead.size());
  }
  const PictureTags found = exif_tags(std::as_bytes(std::span(exif)));
  tags.facts = found.facts;
  tags.colour.is_adobe_rgb = found.colour.is_adobe_rgb;
}

/// Chunks before the pixels, and those allowed after them.
void take_png_chunk(std::string_view type, std::string_view data, bool is_whole,
                    PictureTags& tags) {
  constexpr double kUnit = 1e-5;
  constexpr std::string_view kRawExif = "Raw profile type exif\0"sv;
  constexpr std::string_view kRawApp1 = "Raw profile type APP1\0"sv;
  ColourTags& colour = tags.colour;
  if (type == "iCCP") {
    constexpr std::size_t kMostProfile = std::size_t{16} << 20U;
    const std::size_t name = data.find('\0');
    colour.icc = is_whole && name != std::string_view::npos && name + 2 < data.size()
                     ? inflated(data.substr(name + 2), kMostProfile)
                     : std::vector<std::byte>();
    colour.is_icc_damaged = colour.icc.empty();
  } else if (!is_whole) {
    return;
  } else if (type == "sRGB") {
    colour.is_srgb = true;
  } else if (type == "gAMA" && data.size() == 4) {
    colour.gamma = kUnit * big(data, 0, 4);
  } else if (type == "cHRM" && data.size() == 32) {
    // white first in the file
    Chromaticities all{};
    for (std::size_t i = 0; i < all.size(); ++i) {
      all[(i + 6) % 8] = kUnit * big(data, 4 * i, 4);
    }
    colour.primaries = all;
  } else if (type == "eXIf") {
    take_exif(data, tags);
  } else if (type == "tEXt" && data.starts_with(kRawExif)) {
    take_exif(from_hexadecimal(data.substr(kRawExif.size())), tags);
  } else if (type == "zTXt" && (data.starts_with(kRawExif) || data.starts_with(kRawApp1))) {
    constexpr std::size_t kMostExif = std::size_t{1} << 20U;
    const std::vector<std::byte> text =
        inflated(data.substr(std::min(kRawExif.size() + 1, data.size())), kMostExif);
    take_exif(from_hexadecimal(text_of(text)), tags);
  }
}

}  // namespace

PictureTags exif_tags(std::span<const std::byte> exif) {
  PictureTags tags;
  const ExifBlock block(text_of(exif));
  if (!block.is_good()) {
    return tags;
  }
  constexpr unsigned kOrientation = 0x112;
  constexpr unsigned kModel = 0x110;
  constexpr unsigned kExifDirectory = 0x8769;
  constexpr unsigned kExposureTime = 0x829a;
  constexpr unsigned kFNumber = 0x829d;
  constexpr unsigned kIso = 0x8827;
  constexpr unsigned kTaken = 0x9003;
  constexpr unsigned kColourSpace = 0xa001;
  constexpr unsigned kInteroperability = 0xa005;
  constexpr std::uint32_t kUncalibrated = 0xffff;
  const std::size_t first = block.number(4, 4);
  const std::size_t detail = block.integer(first, kExifDirectory).value_or(0);
  PictureFacts& facts = tags.facts;
  const std::uint32_t orientation = block.integer(first, kOrientation).value_or(1);
  facts.orientation = orientation >= 1 && orientation <= 8 ? static_cast<int>(orientation) : 1;
  facts.model = block.text(first, kModel);
  facts.exposure_s = block.quotient(detail, kExposureTime);
  facts.f_number = block.quotient(detail, kFNumber);
  facts.iso = camera_number(block.integer(detail, kIso).value_or(0));
  facts.taken = block.text(detail, kTaken);
  if (facts.taken.find_first_of("123456789") == std::string::npos) {
    facts.taken.clear();  // blanks or zeros: the clock was not set
  }
  const std::size_t interoperability = block.integer(detail, kInteroperability).value_or(0);
  tags.colour.is_adobe_rgb = block.integer(detail, kColourSpace) == kUncalibrated &&
                             block.text(interoperability, 1) == "R03";
  return tags;
}

bool is_raw_tiff(std::span<const std::byte> file) {
  constexpr unsigned kNewSubfileType = 0xfe;
  constexpr unsigned kPhotometric = 0x106;
  constexpr unsigned kMake = 0x10f;
  constexpr unsigned kSubDirectories = 0x14a;
  constexpr unsigned kDngVersion = 0xc612;
  constexpr std::uint32_t kSensorPattern = 32803;
  const ExifBlock block(text_of(file));
  if (!block.is_good()) {
    return false;
  }
  const std::size_t first = block.number(4, 4);
  const bool is_thumbnail = (block.integer(first, kNewSubfileType).value_or(0) & 1U) != 0;
  return block.find(first, kDngVersion) ||
         block.integer(first, kPhotometric) == kSensorPattern ||
         (is_thumbnail && block.find(first, kMake) && block.find(first, kSubDirectories));
}

PictureTags jpeg_tags(std::span<const std::byte> file) {
  constexpr std::string_view kIccHead = "ICC_PROFILE\0"sv;
  constexpr std::uint32_t kStartOfScan = 0xda;
  constexpr std::uint32_t kApp1 = 0xe1;
  constexpr std::uint32_t kApp2 = 0xe2;
  PictureTags tags;
  bool has_exif = false;
  std::map<std::uint32_t, std::string_view> pieces;  // of the profile, from 1 on
  std::uint32_t n_pieces = 0;
  const std::string_view bytes = text_of(file);
  std::size_t at = 2;
  while (at + 4 <= bytes.size() && big(bytes, at, 1) == 0xff) {
    const std::uint32_t marker = big(bytes, at + 1, 1);
    if (marker == 0xff) {  // fill byte
      ++at;
      continue;
    }
    if (marker == kStartOfScan) {
      break;
    }
    const std::size_t length = big(bytes, at + 2, 2);
    const std::string_view data =
        length >= 2 ? bytes.substr(at + 4, length - 2) : std::string_view();
    if (marker == kApp1 && data.starts_with(kExifHead) && !has_exif) {
      take_exif(data, tags);
      has_exif = true;
    } else if (marker == kApp2 && data.starts_with(kIccHead)) {
      n_pieces = std::max(n_pieces, big(data, kIccHead.size() + 1, 1));
      pieces[big(data, kIccHead.size(), 1)] =
          data.substr(std::min(kIccHead.size() + 2, data.size()));
    }
    at += 2 + std::max<std::size_t>(length, 2);
  }
  std::string profile;
  for (const auto& [number, piece] : pieces) {
    profile += piece;
  }
  tags.colour.icc = bytes_of(profile);
  tags.colour.is_icc_damaged =
      !pieces.empty() && (pieces.size() != n_pieces || pieces.begin()->first != 1 ||
                          pieces.rbegin()->first != n_pieces || profile.empty());
  return tags;
}

PictureTags png_tags(std::span<const std::byte> file) {
  PictureTags tags;
  const std::string_view bytes = text_of(file);
  std::size_t at = 8;
  while (at + 12 <= bytes.size()) {
    const std::size_t length = big(bytes, at, 4);
    const std::string_view type = bytes.substr(at + 4, 4);
    if (length > bytes.size() - at - 12 || type == "IEND") {
      break;
    }
    const auto checksum = type == "IDAT"
                              ? 0
                              : crc32(0, reinterpret_cast<const Bytef*>(bytes.data() + at + 4),
                                      static_cast<uInt>(length + 4));
    take_png_chunk(type, bytes.substr(at + 8, length),
                   checksum == big(bytes, at + 8 + length, 4), tags);
    at += 12 + length;
  }
  return tags;
}

}  // namespace haarlight
