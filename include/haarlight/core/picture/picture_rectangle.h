// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <span>
#include <string>

#include "haarlight/core/image.h"

/// @file
/// A rectangle of pixels that the user names in the upright picture, and where it lies among
/// the pixels as stored. Pure.

namespace haarlight {

/// Pixels [x, x + width) x [y, y + height), y down.
struct PixelRectangle {
  int x = 0;
  int y = 0;
  int width = 0;
  int height = 0;
  friend bool operator==(const PixelRectangle&, const PixelRectangle&) = default;
};

/// "X,Y,W,H".
/// @param option  for errors: "--crop"
/// @throws Error(usage)  not four whole numbers, negative, zero width or height
[[nodiscard]] PixelRectangle parse_rectangle(const std::string& text,
                                             const std::string& option);

/// Where a rectangle of the upright picture lies in the stored one.
/// @param width, height  of the stored picture
/// @param orientation    EXIF's 1..8: how the stored picture is turned or mirrored to be
///                     upright
/// @param option         for errors
/// @throws Error(usage)  it extends beyond the picture, whose upright size is given
[[nodiscard]] PixelRectangle stored_rectangle(const PixelRectangle& upright, int width,
                                              int height, int orientation,
                                              const std::string& option);

/// A rectangle means the same only in pictures of the same orientation.
/// @param orientations  EXIF's, one per picture
/// @throws Error  naming the first picture whose orientation differs from the first one's
void require_same_orientation(std::span<const std::filesystem::path> pictures,
                              std::span<const int> orientations);

/// A copy of these pixels, which lie within the image.
[[nodiscard]] Image<float> cut(const Image<float>& image, const PixelRectangle& rectangle);

}  // namespace haarlight
