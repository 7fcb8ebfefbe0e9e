// SPDX-License-Identifier: Apache-2.0
/// @file
/// Fuzz target: a .rti either reads as a model that can be relit or throws Error.

#include <cstdint>
#include <string_view>

#include "haarlight/relight/reflectance/formats/rti_file.h"
#include "tests/relight/reflectance/formats/fuzz/reflectance_fuzz.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  haarlight::test::read_or_refuse(
      [&] { return haarlight::relight::parse_rti(bytes, "fuzz.rti"); });
  return 0;
}
