#pragma once

#include <string>

#include <nlohmann/json_fwd.hpp>

#include "apps/command_line.h"
#include "capture/daemon_client.h"

/// @file
/// What every verb shares that talks to the daemon.

namespace haarlight {

struct DaemonAddress {
  std::string url = "http://127.0.0.1:8480";
  std::string token_file;
};

/// --daemon and --token-file.
void add_daemon_options(Command verb, DaemonAddress& address);

/// @throws Error  the token's file cannot be read
[[nodiscard]] DaemonClientConfig client_config(const DaemonAddress& address);

/// The answer's JSON object.
/// @throws Error  what the daemon's error says; unavailable: no JSON
[[nodiscard]] nlohmann::json parse_reply(const DaemonReply& reply);

/// One line: phase, session, committed, time left, reason.
void print_state(const nlohmann::json& state);

}  // namespace haarlight
