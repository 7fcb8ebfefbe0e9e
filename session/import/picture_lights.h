// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "haarlight/session/light_file.h"

/// @file
/// Lights described by the pictures themselves: the notes of `haarlight export --exr`
/// (docs/reference/picture-notes.md).

namespace haarlight::session {

/// The light of each picture, in order and named after it, from the notes in the files.
/// @param names  of files in `folder`
/// @throws Error  naming the first picture whose notes lack its light's position, whose numbers
///                are invalid, or that has a direction where others have positions
[[nodiscard]] LightList lights_of_pictures(const std::filesystem::path& folder,
                                           const std::vector<std::string>& names);

/// A picture's position in the one it was cropped from, by its notes; nothing: it is whole, or
/// not an OpenEXR file.
/// @throws Error  naming the picture: numbers that do not fit its size
[[nodiscard]] std::optional<FrameCrop> crop_of_picture(const std::filesystem::path& path,
                                                       int width, int height);

}  // namespace haarlight::session
