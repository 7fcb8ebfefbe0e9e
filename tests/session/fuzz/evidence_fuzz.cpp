// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a frame's description: an Error, or evidence that can be validated and reads
/// back.

#include <cstdint>
#include <string>

#include "haarlight/core/error.h"
#include "session/clean_rule.h"
#include "session/frame_tiff.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  try {
    const haarlight::session::FrameDescription description =
        haarlight::session::frame_description_from_json(text, "frame.tif");
    (void)haarlight::session::find_evidence_problem(description.evidence);
    const std::string written = haarlight::session::frame_description_to_json(description);
    HAARLIGHT_EXPECTS(
        haarlight::session::frame_description_to_json(
            haarlight::session::frame_description_from_json(written, "frame.tif")) == written,
        "a description that reads back");
  } catch (const haarlight::Error&) {
  }
  return 0;
}
