// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/picture/image_io.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstring>
#include <optional>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "core/picture/picture_bytes.h"
#include "core/picture/picture_claim.h"
#include "core/picture/picture_colour.h"
#include "core/picture/picture_formats.h"
#include "core/picture/srgb_codes.h"
#include "haarlight/core/enum_words.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/picture_depth.h"

namespace haarlight {

namespace {

constexpr std::uint64_t kMaxPixels = std::uint64_t{1} << 28U;
constexpr std::uint64_t kMaxSide = std::uint64_t{1} << 17U;
constexpr std::uint64_t kSmall = std::uint64_t{1} << 20U;  // bytes; headers of small pictures

std::atomic<std::uint64_t> most_memory = std::uint64_t{4} << 30U;

/// Nothing: none of the formats that we read.
std::optional<PictureFormat> format_by_magic(std::span<const std::byte> bytes) {
  const auto starts = [&](std::string_view magic, std::size_t at = 0) {
    return bytes.size() >= at + magic.size() &&
           std::memcmp(bytes.data() + at, magic.data(), magic.size()) == 0;
  };
  using namespace std::string_view_literals;
  if (is_raw(bytes)) {
    return PictureFormat::raw;
  }
  if (starts("\xff\xd8\xff"sv)) {
    return PictureFormat::jpeg;
  }
  if (starts("\x89PNG\r\n\x1a\n"sv)) {
    return PictureFormat::png;
  }
  if (starts("II*\0"sv) || starts("MM\0*"sv) || starts("II+\0"sv) || starts("MM\0+"sv)) {
    return PictureFormat::tiff;
  }
  if (starts("\x76\x2f\x31\x01"sv)) {
    return PictureFormat::openexr;
  }
  if (starts("#?RADIANCE"sv) || starts("#?RGBE"sv)) {
    return PictureFormat::hdr;
  }
  // TGA has no magic: one of the six image types, a colour map type of 0 or 1, and a known
  // pixel depth.
  if (bytes.size() >= 18) {
    const auto type = std::to_integer<int>(bytes[2]);
    const auto map = std::to_integer<int>(bytes[1]);
    const auto depth = std::to_integer<int>(bytes[16]);
    const bool is_type =
        type == 1 || type == 2 || type == 3 || type == 9 || type == 10 || type == 11;
    const bool is_depth =
        depth == 8 || depth == 15 || depth == 16 || depth == 24 || depth == 32;
    if (map <= 1 && is_type && is_depth) {
      return PictureFormat::targa;
    }
  }
  return {};
}

/// Offset just after the JPEG's end marker, or 0 when the file ends before it. libjpeg fills
/// what is missing with grey and only warns, so a cut file would pass as a picture.
std::size_t jpeg_end(std::span<const std::byte> bytes) {
  const auto at = [&](std::size_t i) { return std::to_integer<unsigned>(bytes[i]); };
  constexpr unsigned kStartOfScan = 0xda;
  constexpr unsigned kEndOfImage = 0xd9;
  std::size_t i = 2;
  while (i + 4 <= bytes.size()) {
    if (at(i) != 0xff) {
      return 0;
    }
    const unsigned marker = at(i + 1);
    if (marker == 0xff) {  // fill byte
      ++i;
      continue;
    }
    if (marker == kEndOfImage) {
      return i + 2;
    }
    i += 2 + 256 * at(i + 2) + at(i + 3);
    if (marker != kStartOfScan) {
      continue;
    }
    // Entropy-coded data up to the next marker that is neither a stuffed 0xff nor a restart.
    while (i + 1 < bytes.size() &&
           (at(i) != 0xff || at(i + 1) == 0 || (at(i + 1) >= 0xd0 && at(i + 1) <= 0xd7))) {
      ++i;
    }
  }
  return i + 2 == bytes.size() && at(i) == 0xff && at(i + 1) == kEndOfImage ? i + 2 : 0;
}

/// A whole PNG has its IEND chunk (length 0, so its checksum is always the same).
bool has_png_end(std::span<const std::byte> bytes) {
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  return text.rfind("IEND\xae\x42\x60\x82") != std::string_view::npos;
}

PictureContent read_as(PictureFormat format, const PictureSource& source, PictureWish wish) {
  switch (format) {
    case PictureFormat::jpeg:
      return read_jpeg(source, wish);
    case PictureFormat::png:
      return read_png(source, wish);
    case PictureFormat::tiff:
      return read_tiff(source, wish);
    case PictureFormat::openexr:
      return read_exr(source, wish);
    case PictureFormat::hdr:
      return read_hdr(source, wish);
    case PictureFormat::targa:
      return read_tga(source, wish);
    case PictureFormat::raw:
      break;
  }
  return read_raw(source, wish);
}

PictureContent read_content(std::span<const std::byte> bytes, const std::filesystem::path& path,
                            PictureWish wish, std::span<const std::string_view> channels = {}) {
  PictureSource source{.path = path, .bytes = bytes, .channels = channels};
  const std::optional<PictureFormat> format = format_by_magic(bytes);
  if (!format) {
    refuse_picture(
        source, "not a picture that haarlight reads",
        "give a JPEG, PNG, TIFF, OpenEXR, Radiance HDR or TGA file, or a camera's raw file");
  }
  if ((format == PictureFormat::jpeg && jpeg_end(bytes) == 0) ||
      (format == PictureFormat::png && !has_png_end(bytes))) {
    refuse_picture(source, "ends before the picture does", "the file was cut: copy it again");
  }
  if (!channels.empty() && format != PictureFormat::openexr) {
    refuse_picture(source, "not an OpenEXR file, which has named channels",
                   "give a picture that haarlight render surface -o PICTURE.exr has written");
  }
  const PictureClaim claim = picture_claim(*format, bytes);
  if (claim.is_cut) {
    refuse_picture(source, "ends before its header does, or the header is damaged",
                   "the file was cut or damaged: copy it again");
  }
  source.most_per_byte = claim.most_per_byte;
  if (format == PictureFormat::openexr || claim.width * claim.height != 0) {
    require_room(source, claim.width, claim.height, 1, claim.raw_bytes);
  }
  return read_as(*format, source, wish);
}

PictureContent read_content(const std::filesystem::path& path, PictureWish wish,
                            std::span<const std::string_view> channels = {}) {
  const MappedFile mapped(path);
  return read_content(mapped.bytes(), path, wish, channels);
}

PictureFile picture_of(PictureContent content, const std::filesystem::path& path) {
  const PictureColours colours = colours_of({path, {}}, content);
  return {.pixels = std::move(content.pixels),
          .transfer = colours.transfer,
          .bits_per_sample = content.bits_per_sample,
          .is_floating = content.is_floating,
          .facts = content.tags.facts,
          .colours = colours.conversion,
          .profile = colours.name};
}

}  // namespace

void limit_picture_memory(std::uint64_t bytes) noexcept { most_memory = bytes; }

std::uint64_t picture_memory() noexcept { return most_memory; }

void refuse_picture(const PictureSource& source, const std::string& what,
                    const std::string& hint) {
  throw Error(what, source.path.string(), hint);
}

void refuse_damaged(const PictureSource& source, const std::string& why) {
  refuse_picture(source, "cannot be decoded: " + why, "the file is damaged: replace it");
}

void require_room(const PictureSource& source, std::uint64_t width, std::uint64_t height,
                  std::uint64_t channels, std::uint64_t raw_bytes) {
  if (width < 1 || height < 1 || width > kMaxSide || height > kMaxSide ||
      width * height > kMaxPixels) {
    refuse_picture(source, fmt::format("{} x {} pixels", width, height),
                   "a picture must have from 1 to 2^28 pixels, 2^17 per side");
  }
  if (raw_bytes > kSmall && raw_bytes / source.most_per_byte > source.bytes.size()) {
    refuse_picture(source,
                   fmt::format("it claims {} x {} pixels, which its {} bytes cannot hold",
                               width, height, source.bytes.size()),
                   "the file is damaged: replace it");
  }
  const std::uint64_t needed = width * height * channels * sizeof(float) + raw_bytes;
  if (needed > most_memory) {
    refuse_picture(
        source,
        fmt::format("{} x {} pixels take {} MB of memory, more than the {} MB allowed", width,
                    height, needed >> 20U, most_memory.load() >> 20U),
        "give a smaller picture, or more by --memory");
  }
}

void refuse_encoding(const std::string& why) {
  throw Error("cannot be encoded: " + why, "a picture", "this is our own bug",
              ExitCode::internal);
}

PictureFacts read_picture_facts(const std::filesystem::path& path) {
  return read_content(path, PictureWish::header).tags.facts;
}

std::vector<PictureNote> read_picture_notes(const std::filesystem::path& path) {
  return read_content(path, PictureWish::header).notes;
}

PictureFile read_picture(const std::filesystem::path& path) {
  return picture_of(read_content(path, PictureWish::pixels), path);
}

PictureFile read_picture_bytes(std::span<const std::byte> bytes,
                               const std::filesystem::path& name) {
  return picture_of(read_content(bytes, name, PictureWish::pixels), name);
}

Image<float> read_linear_image(const std::filesystem::path& path) {
  return linear_light(read_picture(path), path);
}

namespace {

void require_finite(const Image<float>& image, const std::filesystem::path& path) {
  for (std::size_t i = 0; i < image.pixels().size(); ++i) {
    if (!std::isfinite(image.pixels()[i])) {
      const auto pixel = static_cast<int>(i / static_cast<std::size_t>(image.channels()));
      throw Error(fmt::format("pixel (x {}, y {}) is not a finite number",
                              pixel % image.width(), pixel / image.width()),
                  path.string(), "repair or replace the picture");
    }
  }
}

}  // namespace

Image<float> linear_light(PictureFile picture, const std::filesystem::path& path) {
  require_finite(picture.pixels, path);
  const std::span<float> pixels = picture.pixels.pixels();
  if (picture.colours != nullptr) {
    picture.colours->to_linear(pixels, picture.pixels.channels());
  } else if (picture.transfer == Transfer::srgb) {
    std::transform(pixels.begin(), pixels.end(), pixels.begin(), linear_from_srgb);
  }
  return std::move(picture.pixels);
}

Image<float> read_picture_channels(const std::filesystem::path& path,
                                   std::span<const std::string_view> channels) {
  PictureContent content = read_content(path, PictureWish::pixels, channels);
  require_finite(content.pixels, path);
  return std::move(content.pixels);
}

PictureWithDepth read_picture_with_depth(const std::filesystem::path& path) {
  constexpr auto kChannels = std::to_array<std::string_view>({"R", "G", "B", "Z"});
  PictureContent content = read_content(path, PictureWish::pixels, kChannels);
  const Image<float> all = std::move(content.pixels);
  content.pixels = Image<float>(all.height(), all.width(), 3);
  PictureWithDepth picture{.light = {}, .depth = Image<float>(all.height(), all.width(), 1)};
  for (std::size_t i = 0; i < picture.depth.pixels().size(); ++i) {
    std::copy_n(all.pixels().begin() + static_cast<std::ptrdiff_t>(kChannels.size() * i), 3,
                content.pixels.pixels().begin() + static_cast<std::ptrdiff_t>(3 * i));
    picture.depth.pixels()[i] = all.pixels()[kChannels.size() * i + 3];
  }
  const PictureColours colours = colours_of({path, {}}, content);
  picture.light = linear_light({.pixels = std::move(content.pixels),
                                .transfer = Transfer::linear,
                                .facts = {},
                                .colours = colours.conversion,
                                .profile = {}},
                               path);
  return picture;
}

namespace {

/// The formats that are written, by the endings of their names.
enum class WrittenFormat { png, exr, tif };
constexpr auto kWrittenFormatWords = std::to_array<std::string_view>({".png", ".exr", ".tif"});
constexpr std::span<const std::string_view> words_of(WrittenFormat) {
  return kWrittenFormatWords;
}

WrittenFormat written_format(const std::filesystem::path& path) {
  const std::string ending = path.extension().string();
  const std::optional<WrittenFormat> format = value_of<WrittenFormat>(ending);
  if (!format) {
    throw Error(fmt::format("cannot write a picture named \"{}\"", ending), path.string(),
                "end the name in .exr (linear), .png (to look at) or .tif", ExitCode::usage);
  }
  return *format;
}

void require_no_infinity(const std::filesystem::path& path, ImageView<const float> image) {
  for (int y = 0; y < image.height(); ++y) {
    for (const float value : image.row(y)) {
      if (std::isinf(value)) {
        throw Error(
            fmt::format("a pixel of row {} would be infinite: single precision ends at 3.4e38",
                        y),
            path.string(), "scale the light or the pictures that it is made of down");
      }
    }
  }
}

/// 8-bit sRGB codes of linear light; NaN becomes 0.
Image<std::uint8_t> codes_of(ImageView<const float> image, double exposure) {
  const SrgbCodes& table = SrgbCodes::table();
  Image<std::uint8_t> codes(image.height(), image.width(), image.channels());
  std::uint8_t* to = codes.pixels().data();
  for (int y = 0; y < image.height(); ++y) {
    for (const float value : image.row(y)) {
      *to++ = table.code(value * static_cast<float>(exposure));
    }
  }
  return codes;
}

/// @param name  for errors
std::vector<std::byte> encode_any(WrittenFormat format, const std::filesystem::path& name,
                                  ImageView<const float> image, double exposure,
                                  const PictureNotes& notes,
                                  std::span<const PictureLayer> layers,
                                  const PictureWindow& window,
                                  PngPacking packing = PngPacking::small) {
  HAARLIGHT_EXPECTS(image.channels() == 1 || image.channels() == 3, "1 or 3 channels");
  HAARLIGHT_EXPECTS(!image.is_empty(), "a picture with pixels");
  HAARLIGHT_EXPECTS(window.x >= 0 && window.y >= 0 &&
                        image.width() <= window.full_width - window.x &&
                        image.height() <= window.full_height - window.y,
                    "a part of the larger picture");
  require_no_infinity(name, image);
  for (const PictureLayer& layer : layers) {
    HAARLIGHT_EXPECTS(
        layer.image.width() == image.width() && layer.image.height() == image.height() &&
            layer.channels.size() == static_cast<std::size_t>(layer.image.channels()),
        "a layer of the picture's size, with its channels' names");
    require_no_infinity(name, layer.image);
  }
  PictureNotes all = notes;
  all.texts.push_back({"haarlightProgram", "haarlight " HAARLIGHT_VERSION});
  all.texts.push_back({"haarlightExposure",
                       fmt::format("{:.9g}", format == WrittenFormat::png ? exposure : 1.0)});
  switch (format) {
    case WrittenFormat::png:
      return png_bytes(codes_of(image, exposure).view(), all, packing);
    case WrittenFormat::exr:
      return exr_bytes(image, all, layers, window);
    case WrittenFormat::tif:
      break;
  }
  return tiff_bytes(image);
}

void write_any(const std::filesystem::path& path, ImageView<const float> image, double exposure,
               const PictureNotes& notes, std::span<const PictureLayer> layers,
               const PictureWindow& window) {
  write_file_atomically(
      path, encode_any(written_format(path), path, image, exposure, notes, layers, window));
}

PictureWindow whole_window(ImageView<const float> image) {
  return {.full_width = image.width(), .full_height = image.height()};
}

}  // namespace

void require_picture_name(const std::filesystem::path& path) { (void)written_format(path); }

void write_image(const std::filesystem::path& path, ImageView<const float> image,
                 double exposure, const PictureNotes& notes,
                 std::span<const PictureLayer> layers) {
  write_any(path, image, exposure, notes, layers, whole_window(image));
}

std::vector<std::byte> encode_photograph(const std::filesystem::path& name,
                                         ImageView<const float> image, double exposure,
                                         const PictureNotes& notes) {
  return encode_any(written_format(name), name, image, exposure, notes, {}, whole_window(image),
                    PngPacking::photograph);
}

void write_cropped_image(const std::filesystem::path& path, ImageView<const float> image,
                         double exposure, const PictureWindow& window,
                         std::span<const PictureLayer> layers) {
  write_any(path, image, exposure, {}, layers, window);
}

float srgb_from_linear(float linear) noexcept {
  if (linear < 0.0F) {
    return -srgb_from_linear(-linear);
  }
  return linear <= 0.0031308F ? 12.92F * linear
                              : 1.055F * std::pow(linear, 1.0F / 2.4F) - 0.055F;
}

float linear_from_srgb(float encoded) noexcept {
  if (encoded < 0.0F) {
    return -linear_from_srgb(-encoded);
  }
  return encoded <= 0.04045F ? encoded / 12.92F : std::pow((encoded + 0.055F) / 1.055F, 2.4F);
}

}  // namespace haarlight
