// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <string>

#include "capture/daemon/remote_state.h"
#include "haarlight/capture/daemon/daemon_client.h"
#include "haarlight/core/progress.h"

/// @file
/// Runs a capture on a daemon from outside: starts it, waits for it, and moves its session to
/// the requested location. Stopping the wait does not stop the capture.

namespace haarlight::capture {

struct RemoteCaptureOptions {
  std::string plan;     ///< plan file, or a plan.json
  std::string session;  ///< id of a session to resume, instead of a plan
  std::string output;   ///< moves the finished session there, leaving a link; empty: stays
  ProgressStyle progress = ProgressStyle::none;
  /// Receives what is being waited for, one line without its end; may be empty.
  std::function<void(const std::string& line)> tell;
};

struct RemoteCaptureSummary {
  RemoteState state;    ///< when it finished
  std::string folder;   ///< of the session
  std::string warning;  ///< no link could be left behind; empty: none
};

/// @throws Error(usage)  neither or both of plan and session; an output that exists
/// @throws Error(interrupted)  it was aborted or taken over
/// @throws Error(unavailable)  no answer for 5 s at the beginning, for 30 s later on
[[nodiscard]] RemoteCaptureSummary capture_remotely(DaemonClient& client,
                                                    const RemoteCaptureOptions& options);

}  // namespace haarlight::capture
