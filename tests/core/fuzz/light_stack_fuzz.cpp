// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a light stack, the header's and the bands' hashes put right: pictures of its
/// size, or an Error.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <vector>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/stack/light_stack.h"
#include "tests/memory_file.h"

namespace {

/// The hash over head and table, for as many bands as the header claims.
void sign(std::vector<std::uint8_t>& bytes) {
  std::uint32_t height = 0;
  std::uint32_t band_rows = 0;
  std::memcpy(&height, bytes.data() + 16, sizeof height);
  std::memcpy(&band_rows, bytes.data() + 28, sizeof band_rows);
  const std::size_t n_bands =
      band_rows == 0 ? 0 : (std::size_t{height} + band_rows - 1) / band_rows;
  const std::size_t n_table = std::min(32 * n_bands, bytes.size() - 64);
  const auto* text = reinterpret_cast<const char*>(bytes.data());
  const std::string hash =
      haarlight::content_hash(std::string(text, 32) + std::string(text + 64, n_table));
  std::memcpy(bytes.data() + 32, hash.data(), 32);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::vector<std::uint8_t> bytes(data, data + size);
  if (size >= 64) {
    sign(bytes);
  }
  const haarlight::testing::MemoryFile file(bytes.data(), bytes.size());
  try {
    const haarlight::LightStack stack = haarlight::LightStack::open(file.path());
    HAARLIGHT_EXPECTS(stack.light_images(0, 1).front().height() == stack.dims().height,
                      "its own size");
    stack.check();
  } catch (const haarlight::Error&) {  // NOLINT(bugprone-empty-catch): refused
  }
  return 0;
}
