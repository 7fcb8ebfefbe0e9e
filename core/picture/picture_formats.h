// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/picture/picture_tags.h"
#include "haarlight/core/image.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/picture/picture_window.h"

/// @file
/// Between image_io.cpp and the readers and writers of single formats, one file each; all
/// others use haarlight/core/picture/image_io.h. A reader must trust nothing that a file says:
/// it calls require_room before it allocates memory, and fails only with an Error.

namespace haarlight {

/// A picture file as passed to its reader.
struct PictureSource {
  const std::filesystem::path& path;
  std::span<const std::byte> bytes;
  std::uint64_t most_per_byte = 2000;  ///< the most bytes one byte of the file can decode to
  /// Of an OpenEXR file: these, of the whole picture; empty: its colours.
  std::span<const std::string_view> channels;
};

/// What a reader returns.
struct PictureContent {
  Image<float> pixels;  ///< 1 or 3 channels, as PictureFile, or those that were named; or empty
  int bits_per_sample = 32;  ///< 8 or 16, or 16/32 floating; 32 (integers) in some files
  bool is_floating = true;
  bool is_linear = true;  ///< the file says that its integers are linear light
  PictureTags tags;
  std::vector<PictureNote> notes;  ///< from an OpenEXR file
};

enum class PictureWish { header, pixels };

/// @throws Error  "cannot be decoded: WHY", with a good copy as the hint
[[noreturn]] void refuse_damaged(const PictureSource& source, const std::string& why);
[[noreturn]] void refuse_picture(const PictureSource& source, const std::string& what,
                                 const std::string& hint);

/// Checks a picture's memory against the limits before it is allocated.
/// @param channels   that will be kept
/// @param raw_bytes  of all samples that the decoder produces from the file
/// @throws Error  sides, a size that the file's bytes cannot hold, more than the limit
void require_room(const PictureSource& source, std::uint64_t width, std::uint64_t height,
                  std::uint64_t channels, std::uint64_t raw_bytes);
/// The limit of require_room, bytes.
[[nodiscard]] std::uint64_t picture_memory() noexcept;

/// Integers as 0..1 of their range (signed ones -1..1).
template <class T>
[[nodiscard]] float unit_of(T value) noexcept {
  constexpr float kScale = 1.0F / static_cast<float>(std::numeric_limits<T>::max());
  return static_cast<float>(value) * kScale;
}

[[nodiscard]] PictureContent read_jpeg(const PictureSource& source, PictureWish wish);
[[nodiscard]] PictureContent read_png(const PictureSource& source, PictureWish wish);
[[nodiscard]] PictureContent read_tiff(const PictureSource& source, PictureWish wish);
[[nodiscard]] PictureContent read_exr(const PictureSource& source, PictureWish wish);
[[nodiscard]] PictureContent read_hdr(const PictureSource& source, PictureWish wish);
[[nodiscard]] PictureContent read_tga(const PictureSource& source, PictureWish wish);
/// A camera's sensor data: linear light of Rec. 709 primaries by the camera's matrix, white at
/// daylight (D65), 1.0 where the sensor saturated.
[[nodiscard]] PictureContent read_raw(const PictureSource& source, PictureWish wish);
/// By the first bytes; TIFF files count if they declare sensor values.
[[nodiscard]] bool is_raw(std::span<const std::byte> bytes);

/// How a PNG is packed.
enum class PngPacking {
  small,       ///< zlib's own choice between time and size
  photograph,  ///< for noise, in which longer repeats are chance
};

/// The writers: linear light as it is (EXR, TIFF), sRGB codes (PNG). `image` has 1 or 3
/// channels and is finite.
/// @throws Error(internal)  the library refused
[[nodiscard]] std::vector<std::byte> png_bytes(ImageView<const std::uint8_t> image,
                                               const PictureNotes& notes,
                                               PngPacking packing = PngPacking::small);
[[nodiscard]] std::vector<std::byte> tiff_bytes(ImageView<const float> image);
[[nodiscard]] std::vector<std::byte> exr_bytes(ImageView<const float> image,
                                               const PictureNotes& notes,
                                               std::span<const PictureLayer> layers,
                                               const PictureWindow& window);
[[noreturn]] void refuse_encoding(const std::string& why);

}  // namespace haarlight
