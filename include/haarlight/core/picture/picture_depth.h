// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <span>
#include <string_view>

#include "haarlight/core/image.h"

/// @file
/// Pictures that tell more of what they show than its colours: how far away it is, named channels.

namespace haarlight {

struct PictureWithDepth {
  Image<float> light;  ///< (height, width, 3), linear, Rec. 709; finite
  Image<float> depth;  ///< (height, width, 1), as the file has it
};

/// Reads the channels R, G, B and Z of an OpenEXR file, all of one state of the file.
/// @throws Error  as read_linear_image; the file is of another format, lacks a channel, or is a part of
///                a larger picture
[[nodiscard]] PictureWithDepth read_picture_with_depth(const std::filesystem::path& path);

/// Reads channels of an OpenEXR file by their names, as the file has them.
/// @return (height, width, channels.size())
/// @throws Error  as above; names the first pixel that is NaN or infinite
[[nodiscard]] Image<float> read_picture_channels(const std::filesystem::path& path,
                                                 std::span<const std::string_view> channels);

}  // namespace haarlight
