// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "capture/sequencer/phase.h"
#include "haarlight/capture/daemon/daemon_client.h"

/// @file
/// Parses a daemon's report at /v1/state; and sends the requests that it answers.

namespace haarlight::capture {

/// Keys of docs/reference/http-api.md; empty or 0 where the daemon does not say.
struct RemoteState {
  std::string phase;
  std::string step;
  std::string session;
  std::string folder;
  std::string reason;
  bool is_opening = false;
  int committed = 0;
  int shots = 0;
  int frames = 0;
  int retries = 0;
  std::optional<double> seconds_left;
  std::vector<std::string> unfinished;  ///< ids of sessions

  // Another version's daemon may name what this one does not know: that is in none of these.
  [[nodiscard]] bool is_in(Phase of) const { return phase == to_string(of); }
  [[nodiscard]] bool is_at(ShotStep of) const { return step == to_string(of); }
};

/// @throws Error  what the daemon's error body says; an answer that is not this daemon's
[[nodiscard]] RemoteState read_state(const DaemonReply& reply);
/// GET /v1/state. @throws Error  the same; (unavailable) no answer
[[nodiscard]] RemoteState ask_state(DaemonClient& client);
/// POST /v1/NAME: pause, resume, abort, all-off. Errors as above.
RemoteState request(DaemonClient& client, const std::string& name);
/// Retakes shots of the current session. Errors as above.
RemoteState reshoot(DaemonClient& client, const std::vector<int>& shots);

/// For display: whole lines.
[[nodiscard]] std::string state_text(const RemoteState& state);

}  // namespace haarlight::capture
