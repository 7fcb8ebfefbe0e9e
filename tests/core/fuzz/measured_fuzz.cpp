// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a file of measured values: an Error, or values that are written and read back.

#include <cstdint>
#include <string>

#include "core/rig/measured_rig.h"
#include "haarlight/core/error.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(data, data + size);
  try {
    const haarlight::MeasuredRig measured =
        haarlight::parse_measured(text, "fuzz.measured.toml");
    const std::string written = haarlight::to_toml(measured);
    HAARLIGHT_EXPECTS(
        haarlight::to_toml(haarlight::parse_measured(written, "fuzz.measured.toml")) == written,
        "values that read back");
  } catch (const haarlight::Error&) {  // NOLINT(bugprone-empty-catch): refused
  }
  return 0;
}
