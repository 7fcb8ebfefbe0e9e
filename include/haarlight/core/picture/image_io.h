// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/image.h"
#include "haarlight/core/picture/picture_facts.h"

/// @file
/// Picture files in and out; the daemon does not link it. Formats are recognised by their first
/// bytes, never by their name, and only these are read: JPEG, PNG, TIFF, OpenEXR, Radiance HDR,
/// TGA, and cameras' raw files (docs/reference/pictures.md).

namespace haarlight {

/// How the numbers of a file encode light; unknown: through the camera's own tone curve.
enum class Transfer { linear, srgb, unknown };
inline constexpr auto kTransferWords =
    std::to_array<std::string_view>({"linear", "srgb", "unknown"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(Transfer) noexcept {
  return kTransferWords;
}

class ColourConversion;  ///< core/picture/picture_colour.h

/// A picture as stored in the file.
struct PictureFile {
  Image<float> pixels;  ///< integers scaled to 0..1 of their range, not linearised
  Transfer transfer = Transfer::linear;  ///< srgb for 8/16-bit display files, linear for floats
  int bits_per_sample = 32;              ///< 8 or 16 (unsigned), or 16/32 (floating)
  bool is_floating = true;
  PictureFacts facts;  ///< an orientation is not applied
  /// How the numbers become light, where the file says that its primaries are not sRGB's or its
  /// curve is none of `transfer`; else empty.
  std::shared_ptr<const ColourConversion> colours;
  std::string profile;  ///< its name: "Adobe RGB (1998)"; empty: sRGB or linear
};

/// Reads a picture without changing its transfer. Alpha is dropped.
/// @throws Error  names the file and what is wrong: not a picture, truncated, too large (more
///                than 2^28 pixels, or the limit below), a size that its bytes cannot hold, no
///                colour channels. Sizes are checked before memory is allocated for them.
[[nodiscard]] PictureFile read_picture(const std::filesystem::path& path);

/// What the camera wrote into a picture; its pixels are not read.
/// @throws Error  as read_picture
[[nodiscard]] PictureFacts read_picture_facts(const std::filesystem::path& path);

/// Sets the most memory that a picture may take, bytes; 4 GiB by default. For main, which knows
/// --memory.
void limit_picture_memory(std::uint64_t bytes) noexcept;

/// Reads a picture as linear light of Rec. 709 primaries: by the colour profile that the file
/// carries (ICC; PNG's gAMA and cHRM; EXIF's Adobe RGB flag; OpenEXR's chromaticities); without
/// one, integers are decoded as sRGB and floats are taken as they are.
/// @throws Error  as read_picture; also names the first pixel that is NaN or infinite.
[[nodiscard]] Image<float> read_linear_image(const std::filesystem::path& path);

/// The same for a picture that has been read.
/// @param path  for errors
[[nodiscard]] Image<float> linear_light(PictureFile picture, const std::filesystem::path& path);

/// Refuses a name that write_image could not write, before any work is done.
/// @throws Error(usage)  listing the extensions
void require_picture_name(const std::filesystem::path& path);

/// A text field that describes a picture.
struct PictureNote {
  std::string name;  ///< letters only: PNG's keyword, OpenEXR's attribute
  std::string text;  ///< Latin-1 if PNG is to show it
};

/// Metadata of a written picture: texts, and the facts of the photographs it was made from.
struct PictureNotes {
  std::vector<PictureNote> texts;
  PictureFacts facts;
};

/// The notes of an OpenEXR file, in the order of their names; its pixels are not read. Empty
/// for other formats.
/// @throws Error  as read_picture
[[nodiscard]] std::vector<PictureNote> read_picture_notes(const std::filesystem::path& path);

/// Further channels of an OpenEXR file: features, errors.
struct PictureLayer {
  std::vector<std::string> channels;  ///< full names, one for each of the image's: "normal.X"
  ImageView<const float> image;       ///< of the picture's size
};

/// Writes by file extension: `.exr` linear 32-bit float; `.png` sRGB 8 bit, values times
/// `exposure` clipped to 0..1; `.tif` linear 32-bit float. The file appears complete or not at
/// all.
/// @param image  1 or 3 channels
/// @param notes  texts: PNG's tEXt chunks, OpenEXR's string attributes; after them come
///               haarlightProgram and haarlightExposure (1 except for PNG). Facts: PNG's eXIf
///               chunk, OpenEXR's standard attributes (expTime, aperture, isoSpeed, capDate,
///               cameraModel). TIFF has no field for either. No dates are added: the same
///               picture gives the same bytes.
/// @param layers  written to `.exr` alone
/// @throws Error  unknown extension, unwritable folder, full disk
void write_image(const std::filesystem::path& path, ImageView<const float> image,
                 double exposure = 1.0, const PictureNotes& notes = {},
                 std::span<const PictureLayer> layers = {});

/// The bytes that write_image would write to a file of this name, but that a PNG is packed for
/// photographs: runs and frequencies of values alone, in a seventh of the time and 7 % larger.
/// @throws Error  as write_image, but for the disk
[[nodiscard]] std::vector<std::byte> encode_photograph(const std::filesystem::path& name,
                                                       ImageView<const float> image,
                                                       double exposure = 1.0,
                                                       const PictureNotes& notes = {});

/// sRGB transfer (IEC 61966-2-1), both ways; exact inverses to 1e-7. Negative values are
/// mirrored.
[[nodiscard]] float srgb_from_linear(float linear) noexcept;
[[nodiscard]] float linear_from_srgb(float encoded) noexcept;

}  // namespace haarlight
