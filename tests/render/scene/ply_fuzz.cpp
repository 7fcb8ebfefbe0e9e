// SPDX-License-Identifier: Apache-2.0
/// @file
/// Fuzz target: a PLY file either reads as a sound scene or throws Error.

#include "tests/render/scene/mesh_fuzz.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  haarlight::test::read_or_refuse(
      [](std::string_view bytes) { return haarlight::render::parse_ply(bytes, "fuzz.ply"); },
      data, size);
  return 0;
}
