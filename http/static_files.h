// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/files.h"

/// @file
/// Files of one folder, and of no other.

namespace haarlight::http {

struct StaticFile {
  Fd fd;
  std::uint64_t size = 0;
  std::string content_type;
};

/// Opens folder/segment/segment/... one step at a time with openat(O_NOFOLLOW), so neither ".."
/// nor a symbolic link leads out. Nothing for names that start with a dot, links, and anything
/// other than a regular file. @param segments  decoded; empty: index.html
[[nodiscard]] std::optional<StaticFile> open_static_file(
    const std::filesystem::path& folder, const std::vector<std::string>& segments);

/// By file extension; "application/octet-stream" for an unknown one.
[[nodiscard]] std::string_view content_type_of(std::string_view name);

}  // namespace haarlight::http
