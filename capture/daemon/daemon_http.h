// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <memory>

#include "http/event_stream.h"
#include "http/site.h"

/// @file
/// The daemon's HTTP interface, documented in docs/reference/http-api.md. Every handler looks
/// things up or leaves a message; none waits for a device.

namespace haarlight::capture {

class Daemon;

/// @param daemon  outlives the server
[[nodiscard]] http::HttpSite make_site(Daemon& daemon,
                                       std::shared_ptr<http::EventStream> events,
                                       const std::filesystem::path& sessions,
                                       const std::filesystem::path& web_folder);

/// GET /v1/state as JSON.
struct DaemonState;
[[nodiscard]] std::string daemon_state_json(const DaemonState& state);

}  // namespace haarlight::capture
