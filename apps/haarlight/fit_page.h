// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>

#include "apps/haarlight/verb.h"

/// @file
/// The page that a fit's web folder opens with.

namespace haarlight::apps {

/// Adds it where the fit wrote a web folder and the program's pages are installed, and says how
/// to open it, or why there is none.
void add_page_to_fit(const std::filesystem::path& out, const CommonOptions& common);

}  // namespace haarlight::apps
