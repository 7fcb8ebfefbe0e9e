// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "apps/command_line.h"
#include "haarlight/capture/daemon/daemon_client.h"

/// @file
/// What every verb shares that talks to the daemon.

namespace haarlight::apps {

struct DaemonAddress {
  std::string url = "http://127.0.0.1:8480";
  std::string token_file;
};

/// --daemon and --token-file.
void add_daemon_options(Command verb, DaemonAddress& address);

/// @throws Error  the token's file cannot be read
[[nodiscard]] capture::DaemonClientConfig client_config(const DaemonAddress& address);

}  // namespace haarlight::apps
