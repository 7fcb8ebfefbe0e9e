// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as session.json: an Error, or a session that is written and read back the same.

#include <cstdint>
#include <string>

#include "haarlight/core/error.h"
#include "haarlight/session/session.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  try {
    const haarlight::session::SessionInfo info =
        haarlight::session::session_info_from_json(text, "session.json");
    const std::string written = haarlight::session::session_info_to_json(info);
    HAARLIGHT_EXPECTS(
        haarlight::session::session_info_to_json(
            haarlight::session::session_info_from_json(written, "session.json")) == written,
        "a session that reads back");
  } catch (const haarlight::Error&) {
  }
  return 0;
}
