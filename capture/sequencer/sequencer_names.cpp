// SPDX-License-Identifier: Apache-2.0
/// @file
/// Why a run is suspended, for logs, events and the HTTP interface.

#include "capture/sequencer/sequencer.h"

namespace haarlight::capture {

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

}  // namespace haarlight::capture
