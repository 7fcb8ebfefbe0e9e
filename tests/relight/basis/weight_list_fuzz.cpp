// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a JSON list of weights: finite weights for 4 lights, or an Error.

#include <cstdint>

#include "haarlight/core/error.h"
#include "relight/basis/weight_list.h"
#include "tests/memory_file.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const haarlight::testing::MemoryFile file(data, size);
  try {
    HAARLIGHT_EXPECTS(haarlight::relight::weights_from_json(file.path(), 4).allFinite(),
                      "finite weights");
  } catch (const haarlight::Error&) {  // NOLINT(bugprone-empty-catch): refused
  }
  return 0;
}
