// SPDX-License-Identifier: Apache-2.0
/// @file
/// Fuzz target: a PLOT3D grid and the solution on it either read as a mesh or throw Error. The
/// first two bytes are the length of the grid, little-endian; what follows it is the solution,
/// if anything does.

#include <algorithm>
#include <optional>

#include "tests/render/cell_mesh/mesh_fuzz.h"

namespace {

haarlight::render::CellMesh read_pair(std::string_view bytes) {
  using haarlight::render::NamedBytes;
  std::size_t n_grid = 0;
  for (std::size_t i = 0; i < std::min<std::size_t>(bytes.size(), 2); ++i) {
    n_grid |= static_cast<std::size_t>(static_cast<unsigned char>(bytes[i])) << 8U * i;
  }
  bytes.remove_prefix(std::min<std::size_t>(bytes.size(), 2));
  const NamedBytes grid{.bytes = bytes.substr(0, n_grid), .name = "fuzz.xyz"};
  std::optional<NamedBytes> solution;
  if (bytes.size() > n_grid) {
    solution = NamedBytes{.bytes = bytes.substr(n_grid), .name = "fuzz.q"};
  }
  return haarlight::render::parse_plot3d(grid, solution);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  haarlight::test::read_or_refuse_mesh(read_pair, data, size);
  return 0;
}
