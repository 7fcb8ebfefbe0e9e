// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/basis_check.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include <fmt/format.h>

#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

void require_finite(const std::vector<float>& values, const BasisFile& basis, int tile,
                    int channel) {
  if (!std::all_of(values.begin(), values.end(), [](float x) { return std::isfinite(x); })) {
    throw Error("a value is not a finite number",
                fmt::format("{}, tile {}, channel {}", basis.name(), tile, channel),
                "make it again with haarlight compress");
  }
}

void check_tile(const BasisFile& basis, int tile, int channel) {
  (void)basis.pixels(tile, channel);
  if (basis.header().coding == BasisCoding::integers) {
    require_finite(basis.decode_tile(tile, channel), basis, tile, channel);
    return;
  }
  for (int group = 0; group < basis.n_groups(); ++group) {
    if (basis.header().coding == BasisCoding::quantised) {
      (void)basis.sparse(tile, channel, group);
    } else {
      require_finite(basis.floats(tile, channel, group), basis, tile, channel);
    }
  }
}

}  // namespace

void check_basis(const BasisFile& basis) {
  const auto n_channels = static_cast<std::size_t>(basis.header().dims.channels);
  const std::size_t n = static_cast<std::size_t>(basis.n_tiles()) * n_channels;
  parallel_for(n, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      check_tile(basis, static_cast<int>(i / n_channels), static_cast<int>(i % n_channels));
    }
  });
}

}  // namespace haarlight::relight
