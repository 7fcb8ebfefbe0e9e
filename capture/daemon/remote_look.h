// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "capture/daemon/daemon_client.h"

/// @file
/// What the daemon's page shows, from outside: its sessions, a shot's story, a live picture.

namespace haarlight {

struct RemoteSession {
  std::string id;
  std::string state;  ///< active, finished, aborted, unfinished
  std::string folder;
};
/// @throws Error  what the daemon says; (unavailable) nobody answers
[[nodiscard]] std::vector<RemoteSession> list_sessions(DaemonClient& client);

/// What proves a shot's frame.
struct ShotStory {
  std::string mark;  ///< as on the page's map
  std::string text;  ///< for a person, whole lines
  std::string path;  ///< of the shot, below the daemon's address
};
/// @param session  id; empty: the present one
/// @throws Error(interrupted)  there is none; as above
[[nodiscard]] ShotStory tell_shot(DaemonClient& client, const std::string& session, int shot);
/// The shot's frame, small, clipping marked: the bytes of a PNG. Errors as above.
[[nodiscard]] std::string frame_picture(DaemonClient& client, const ShotStory& story);

struct PreviewOptions {
  std::vector<int> lights;
  double level_percent = 100.0;  ///< of full drive
  double exposure_us = 0.0;      ///< 0: the rig file's
};
/// Returns when the light stands; it goes out by itself after a minute.
/// @throws Error(interrupted)  it went out again; (unavailable) it does not come on; as above
void light_preview(DaemonClient& client, const PreviewOptions& options);
/// What the camera sees meanwhile, clipping marked: the bytes of a PNG. Errors as above.
[[nodiscard]] std::string preview_picture(DaemonClient& client);

}  // namespace haarlight
