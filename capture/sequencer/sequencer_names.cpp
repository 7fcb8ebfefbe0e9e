// SPDX-License-Identifier: Apache-2.0
/// @file
/// Names of the enumerators of capture/sequencer/sequencer.h for logs, events and the HTTP
/// interface.

#include "capture/sequencer/sequencer.h"

namespace haarlight {

std::string_view to_string(Phase phase) noexcept {
  switch (phase) {
    case Phase::boot:
      return "boot";
    case Phase::recover:
      return "recover";
    case Phase::idle:
      return "idle";
    case Phase::preflight:
      return "preflight";
    case Phase::running:
      return "running";
    case Phase::paused:
      return "paused";
    case Phase::suspended:
      return "suspended";
    case Phase::aborting:
      return "aborting";
    case Phase::finalise:
      return "finalise";
    case Phase::done:
      return "done";
    case Phase::safe_off:
      return "safe-off";
  }
  return "?";
}

std::string_view to_string(ShotStep shot_step) noexcept {
  switch (shot_step) {
    case ShotStep::none:
      return "none";
    case ShotStep::light:
      return "light";
    case ShotStep::settle:
      return "settle";
    case ShotStep::collect:
      return "collect";
  }
  return "?";
}

std::string_view to_string(ShotState state) noexcept {
  switch (state) {
    case ShotState::pending:
      return "pending";
    case ShotState::exposing:
      return "exposing";
    case ShotState::checking:
      return "checking";
    case ShotState::committing:
      return "committing";
    case ShotState::committed:
      return "committed";
  }
  return "?";
}

std::string reasons_text(std::uint32_t reasons) {
  std::string text;
  const auto add = [&](std::uint32_t bit, std::string_view word) {
    if ((reasons & bit) != 0) {
      text += text.empty() ? "" : ", ";
      text += word;
    }
  };
  add(kCameraLost, "camera");
  add(kControllerLost, "controller");
  add(kDiskFull, "disk");
  add(kNoEvidence, "no clean frame");
  add(kHeldBack, "held back");
  add(kFolderGone, "session folder");
  add(kWrongLight, "wrong light");
  return text;
}

}  // namespace haarlight
