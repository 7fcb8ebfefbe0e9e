// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a photograph whose rows are fitted: rows or an Error.

#include <cstdint>
#include <vector>

#include "haarlight/core/error.h"
#include "relight/reflectance/fit/picture_rows.h"
#include "tests/memory_file.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const haarlight::testing::MemoryFile file(data, size);
  try {
    const auto rows = haarlight::relight::jpeg_rows({file.path()});
    const haarlight::StackDims shape = rows->dims();
    constexpr int kMostRows = 64;  // enough is tested without more
    std::vector<std::uint16_t> row(static_cast<std::size_t>(shape.width) * 3);
    for (int y = 0; y < shape.height && y < kMostRows; ++y) {
      rows->read(1, row);
    }
    if (shape.height > kMostRows) {
      rows->skip(shape.height - kMostRows);
    }
    rows->rewind();
    rows->read(1, row);
  } catch (const haarlight::Error&) {  // NOLINT(bugprone-empty-catch): refused
  }
  return 0;
}
