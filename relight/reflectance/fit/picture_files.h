// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "relight/reflectance/fit/picture_rows.h"

/// @file
/// Picture files of any kind that core reads (haarlight/core/picture/image_io.h) as rows, by their colour
/// profiles.

namespace haarlight::relight {

struct PictureFilesOptions {
  /// Beyond this, 16-bit codes of pictures that are not read line by line go to an unnamed
  /// temporary file in `work_folder`, 6 bytes per pixel and picture.
  std::uint64_t memory_bytes = std::uint64_t{1} << 29U;
  std::filesystem::path work_folder = std::filesystem::temp_directory_path();
};

struct PictureFiles {
  std::unique_ptr<PictureRows> rows;  ///< srgb
  std::string profile;  ///< applied to the first picture: "Adobe RGB (1998)"; empty: none
};

/// Baseline JPEGs in sRGB are read line by line (jpeg_rows). If any picture is not, each is
/// decoded whole in turn, converted to sRGB by its colour profile (via linear light clipped to
/// 0..1), and kept as 16-bit codes.
/// @throws Error  naming the picture: not one that core reads; another size; floating values,
///                whose white is not known
[[nodiscard]] PictureFiles picture_rows(std::vector<std::filesystem::path> pictures,
                                        const PictureFilesOptions& options = {});

}  // namespace haarlight::relight
