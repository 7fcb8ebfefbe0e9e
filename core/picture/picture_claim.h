// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

/// @file
/// What a picture file claims as its size, read from its header before a decoder sees it:
/// decoders allocate memory for whatever a header claims.

namespace haarlight {

/// The formats that are read.
enum class PictureFormat { jpeg, png, tiff, openexr, hdr, targa, raw };

struct PictureClaim {
  std::uint64_t width = 0;  ///< 0: not found in the header
  std::uint64_t height = 0;
  /// Bytes of the pixels before compression; or of the largest piece a decoder works on, where
  /// that is more.
  std::uint64_t raw_bytes = 0;
  /// The most bytes that one byte of the file can decode to.
  std::uint64_t most_per_byte = 2000;
  bool is_cut = false;  ///< the file ends within its header, or the header is damaged (OpenEXR)
};

/// Nothing is known of TIFF and raw files, whose headers libtiff and libraw read without
/// allocating memory.
[[nodiscard]] PictureClaim picture_claim(PictureFormat format,
                                         std::span<const std::byte> bytes);

}  // namespace haarlight
