// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>

/// @file
/// Sizes of results.

namespace haarlight::relight {

/// Bytes of a file, or of all files in a folder and its subfolders.
[[nodiscard]] std::uintmax_t bytes_on_disk(const std::filesystem::path& path);

}  // namespace haarlight::relight
