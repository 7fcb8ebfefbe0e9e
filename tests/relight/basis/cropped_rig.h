// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <map>
#include <string>

#include "haarlight/core/error.h"
#include "haarlight/core/rig/rig.h"

namespace haarlight::test {

/// cube32's rig with lines replaced: the middle 64 x 48 pixels of its view unless requested
/// otherwise.
inline Rig cropped_rig(const std::map<std::string, std::string>& lines = {}) {
  Rig file = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/cube32.toml");
  std::string text = file.text;
  const auto replace = [&text](const std::string& from, const std::string& to) {
    const std::size_t at = text.find(from);
    HAARLIGHT_EXPECTS(at != std::string::npos, "a line of the rig file");
    text.replace(at, from.size(), to);
  };
  replace("size = [320, 248]", "size = [64, 48]");
  replace("active_area = 240", "active_area = 48");
  replace("K = [[439.596387, 0.0, 160.0], [0.0, 439.596387, 120.0]",
          "K = [[439.596387, 0.0, 32.0], [0.0, 439.596387, 24.0]");
  for (const auto& [from, to] : lines) {
    replace(from, to);
  }
  return parse_rig(text, "made.toml");
}

}  // namespace haarlight::test
