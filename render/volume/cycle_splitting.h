// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "render/volume/convex_body.h"
#include "render/volume/volume_view.h"

/// @file
/// Cells that obstruct each other in rings, cut by the planes of each other's faces until their pieces
/// have an order.

namespace haarlight::render {

/// A convex piece of a cell: where it is within all cuts; the whole cell if there are none.
struct CellPiece {
  std::uint32_t cell = 0;
  std::vector<HalfSpace> cuts;
};

/// For each of a directed graph's nodes those that its edges lead to.
using Successors = std::vector<std::vector<std::uint32_t>>;

/// A shortest cycle through the node; empty: there is none.
[[nodiscard]] std::vector<std::uint32_t> shortest_cycle(const Successors& graph,
                                                        std::uint32_t node);

/// @param cells    of one component, convex
/// @param hidden   of each, as numbers in `cells`: those that a ray may meet next after it
/// @return  the pieces, the farthest first
/// @throws Error  they are in no order after many cuts: by their numbers in the file
[[nodiscard]] std::vector<CellPiece> split_cycles(const VolumeView& view,
                                                  std::span<const std::uint32_t> cells,
                                                  const Successors& hidden);

}  // namespace haarlight::render
