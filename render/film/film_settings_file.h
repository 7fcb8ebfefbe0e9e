// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>

#include "render/film/film_file.h"

/// @file
/// What a film on disk is of.

namespace haarlight::render {

/// Its settings, without its sums: they are not looked at.
/// @throws Error  not a film
[[nodiscard]] RenderSettings read_film_settings(const std::filesystem::path& path);

}  // namespace haarlight::render
