// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "session/light_file.h"

/// @file
/// Lights that pictures name themselves: the notes of `haarlight export --exr`
/// (docs/reference/picture-notes.md).

namespace haarlight {

/// The light of each picture, in order and named after it, from the notes in the files.
/// @param names  of files in `folder`
/// @throws Error  naming the first picture whose notes do not say where its light is, whose
///                numbers are none, or that has a direction where others have places
[[nodiscard]] LightList lights_of_pictures(const std::filesystem::path& folder,
                                           const std::vector<std::string>& names);

/// Where a picture lies in that which it was cut out of, by its notes; nothing: it is whole, or
/// no OpenEXR file.
/// @throws Error  naming the picture: numbers that do not fit its size
[[nodiscard]] std::optional<FrameCrop> crop_of_picture(const std::filesystem::path& path,
                                                       int width, int height);

}  // namespace haarlight
