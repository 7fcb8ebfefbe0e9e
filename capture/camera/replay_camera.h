// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <vector>

#include "capture/camera/camera.h"
#include "haarlight/session/session.h"

/// @file
/// A finished session as a camera: its frames in order of exposure, each once, with the
/// timestamps, sequence numbers and flags they were captured with. Lets the sequencer validate
/// an old capture again (tests/capture/camera/replay_test.cpp). Pictures without measured times are
/// refused: they hold nothing to validate.

namespace haarlight::capture {

class ReplayCamera final : public Camera {
 public:
  /// `spec.device` is the session's folder. Faults: unsupported (an import: evidence is only
  /// asserted; no 16-bit frames), io (not a session).
  [[nodiscard]] Result<CameraSetup> start(const CameraSpec& spec) override;
  /// Never waits. Fault device_gone after the last frame.
  [[nodiscard]] Result<Frame> next(std::chrono::steady_clock::time_point deadline) override;
  /// Exposures are already fixed: returns the value that the next frame has.
  [[nodiscard]] Result<double> set_exposure(double exposure_us) override;
  void stop() noexcept override;

  /// The next frame's record.
  [[nodiscard]] const session::FrameRecord* upcoming() const;

 private:
  std::optional<session::Session> session_;
  std::vector<session::FrameRecord> frames_;  ///< by timestamp
  std::size_t next_ = 0;
};

}  // namespace haarlight::capture
