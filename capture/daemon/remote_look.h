// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "haarlight/capture/daemon/daemon_client.h"

/// @file
/// What the daemon's page shows, from outside: its sessions, a shot's history, a live picture.

namespace haarlight::capture {

struct RemoteSession {
  std::string id;
  std::string state;  ///< active, finished, aborted, unfinished
  std::string folder;
};
/// @throws Error  what the daemon says; (unavailable) no answer
[[nodiscard]] std::vector<RemoteSession> list_sessions(DaemonClient& client);

/// The evidence for a shot's frame.
struct ShotStory {
  std::string mark;  ///< as on the page's map
  std::string text;  ///< for display, whole lines
  std::string path;  ///< of the shot, below the daemon's address
};
/// @param session  id; empty: the current one
/// @throws Error(interrupted)  there is none; as above
[[nodiscard]] ShotStory tell_shot(DaemonClient& client, const std::string& session, int shot);
/// The shot's frame, reduced, with clipping marked: the bytes of a PNG. Errors as above.
[[nodiscard]] std::string frame_picture(DaemonClient& client, const ShotStory& story);

struct PreviewOptions {
  std::vector<int> lights;
  double level_percent = 100.0;  ///< of full drive
  double exposure_us = 0.0;      ///< 0: the rig file's
};
/// Returns when the light has settled; it turns off by itself after a minute.
/// @throws Error(interrupted)  it turned off again; (unavailable) it does not turn on; as above
void light_preview(DaemonClient& client, const PreviewOptions& options);
/// What the camera sees meanwhile, with clipping marked: the bytes of a PNG. Errors as above.
[[nodiscard]] std::string preview_picture(DaemonClient& client);

}  // namespace haarlight::capture
