// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/frame_verdict.h"

namespace haarlight {

const std::vector<std::string_view>& frame_verdict_words() {
  static const std::vector<std::string_view> kWords = {"good",      "no_picture",  "saturated",
                                                       "too_dark",  "wrong_level", "stale",
                                                       "duplicate", "wrong_light"};
  return kWords;
}

std::string_view to_string(FrameVerdict verdict) noexcept {
  return frame_verdict_words()[static_cast<std::size_t>(verdict)];
}

}  // namespace haarlight
