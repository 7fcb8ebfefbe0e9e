// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a rig file: either a rig or an Error.

#include <cstdint>
#include <string>

#include "haarlight/core/error.h"
#include "haarlight/core/rig/rig.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    (void)haarlight::parse_rig(std::string(data, data + size), "fuzz.toml");
  } catch (const haarlight::Error&) {
  }
  return 0;
}
