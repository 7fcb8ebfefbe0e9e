// SPDX-License-Identifier: Apache-2.0
/// @file
/// Fuzz target: a .msh file either reads as a mesh or throws Error.

#include "tests/render/cell_mesh/mesh_fuzz.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  haarlight::test::read_or_refuse_mesh(
      [](std::string_view bytes) { return haarlight::render::parse_msh(bytes, "fuzz.msh"); },
      data, size);
  return 0;
}
