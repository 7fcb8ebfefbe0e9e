// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "haarlight/core/picture/image_io.h"

/// @file
/// The metadata next to the pixels in JPEG, PNG and TIFF: EXIF, colour profiles, PNG's colour
/// chunks. We parse it ourselves: a damaged tag must not silently cost the picture, nor memory.

namespace haarlight {

/// Red, green, blue and white, x and y each.
using Chromaticities = std::array<double, 8>;

/// What a file says about its colours; nothing: it is sRGB, or linear where its values are
/// floats.
struct ColourTags {
  std::vector<std::byte> icc;  ///< profile; empty: none
  bool is_icc_damaged = false;
  bool is_srgb = false;         ///< PNG: sRGB chunk
  std::optional<double> gamma;  ///< PNG's gAMA: code = light^gamma
  std::optional<Chromaticities> primaries;
  bool is_adobe_rgb = false;  ///< EXIF: uncalibrated, interoperability R03
};

struct PictureTags {
  PictureFacts facts;
  ColourTags colour;
};

/// Never throws on account of the content: what cannot be read is left out.
[[nodiscard]] PictureTags jpeg_tags(std::span<const std::byte> file);
[[nodiscard]] PictureTags png_tags(std::span<const std::byte> file);
/// EXIF is a kind of TIFF file: a whole TIFF, or what a JPEG or PNG holds. Source: CIPA DC-008
/// (EXIF 2.32); nothing is read from a BigTIFF.
[[nodiscard]] PictureTags exif_tags(std::span<const std::byte> exif);
/// Whether a TIFF is a camera's raw file: a DNG; a sensor mosaic as its first picture; or a
/// vendor's thumbnail there, with the picture in a sub-directory (NEF, ARW and others).
[[nodiscard]] bool is_raw_tiff(std::span<const std::byte> file);

}  // namespace haarlight
