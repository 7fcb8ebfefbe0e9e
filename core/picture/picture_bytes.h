// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <filesystem>
#include <span>

#include "haarlight/core/picture/image_io.h"

/// @file
/// Pictures inside other files.

namespace haarlight {

/// read_picture of its bytes. @param name  for errors
[[nodiscard]] PictureFile read_picture_bytes(std::span<const std::byte> bytes,
                                             const std::filesystem::path& name);

}  // namespace haarlight
