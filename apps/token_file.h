// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>

namespace haarlight::apps {

/// A server's token, without the line break at its end.
/// @throws Error  missing, unreadable, more than 4 kB
[[nodiscard]] std::string read_token(const std::filesystem::path& file);

}  // namespace haarlight::apps
