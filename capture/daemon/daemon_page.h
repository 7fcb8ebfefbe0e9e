// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>

#include "http/site.h"

/// @file
/// What the page requests in addition to the daemon's plain interface
/// (capture/daemon/daemon_http.h): the rig, a session's map of marks, a shot with its evidence
/// in words, pictures with clipping marked, and the cost of a plan being written. All
/// read-only; documented in docs/reference/http-api.md.

namespace haarlight::capture {

class Daemon;

/// @param daemon  outlives the site
void add_page_routes(http::HttpSite& site, Daemon& daemon,
                     const std::filesystem::path& sessions);

}  // namespace haarlight::capture
