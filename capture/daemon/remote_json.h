// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "core/text_limits.h"
#include "haarlight/capture/daemon/daemon_client.h"
#include "haarlight/core/error.h"

/// @file
/// A daemon's answer as a JSON object, for sources that include the JSON library.

namespace haarlight::capture {

/// @throws Error  what the daemon's error body says
/// @throws Error(unavailable)  not a JSON object: not from this daemon
template <typename Json>
[[nodiscard]] Json parse_reply(const DaemonReply& reply) {
  DaemonClient::require_good(reply);
  Json json = parse_json<Json>(reply.body, "haarlightd");
  if (!json.is_object()) {
    throw Error("the daemon's answer is not JSON", "haarlightd",
                "is another program listening at this address?", ExitCode::unavailable);
  }
  return json;
}

}  // namespace haarlight::capture
