// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>

/// @file
/// How large results are.

namespace haarlight {

/// Of a file, or of all files of a folder and its folders, bytes.
[[nodiscard]] std::uintmax_t bytes_on_disk(const std::filesystem::path& path);

}  // namespace haarlight
