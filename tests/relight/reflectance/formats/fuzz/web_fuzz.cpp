// SPDX-License-Identifier: Apache-2.0
/// @file
/// Fuzz target: an info.json, a 0 byte, then the picture that stands for every plane_k.jpg,
/// either reads as a model that can be relit or throws Error.

#include <cstdint>
#include <string>
#include <string_view>

#include "haarlight/relight/reflectance/formats/web_folder.h"
#include "tests/relight/reflectance/formats/fuzz/reflectance_fuzz.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  const std::size_t end = bytes.find('\0');
  std::string picture(end == std::string_view::npos ? "" : bytes.substr(end + 1));
  haarlight::test::read_or_refuse([&] {
    return haarlight::relight::parse_web_folder(
        bytes.substr(0, end), [&](const std::string&) { return picture; }, "fuzz");
  });
  return 0;
}
