// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>

/// @file
/// Where the pages' files are.

namespace haarlight::apps {

/// The folder web/: as installed beside the program, or in the sources that it was built from.
/// Empty when there is none.
[[nodiscard]] std::filesystem::path find_page_folder();

}  // namespace haarlight::apps
