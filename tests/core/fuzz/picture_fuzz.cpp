// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a picture of each format that we read: pixels or an Error, and never more
/// memory than the limit (what the formats' libraries take counts too).

#include <cstdint>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "tests/memory_file.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  haarlight::limit_picture_memory(std::uint64_t{256} << 20U);
  const haarlight::testing::MemoryFile file(data, size);
  try {
    (void)haarlight::read_linear_image(file.path());
  } catch (const haarlight::Error&) {  // NOLINT(bugprone-empty-catch): refused
  }
  return 0;
}
