// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <span>

#include "haarlight/core/picture/image_io.h"

/// @file
/// Pictures that are a crop of a larger one, and files that say of which part.

namespace haarlight {

/// Where a picture's pixels are in the larger one.
struct PictureWindow {
  int x = 0;  ///< of its first pixel, from the left
  int y = 0;  ///< from the top
  int full_width = 0;
  int full_height = 0;
};

/// As write_image. In an `.exr` the picture is the data window and the larger one the display
/// window: programs that know of them show it where it belongs. Other formats have no such field.
void write_cropped_image(const std::filesystem::path& path, ImageView<const float> image,
                         double exposure, const PictureWindow& window,
                         std::span<const PictureLayer> layers = {});

}  // namespace haarlight
