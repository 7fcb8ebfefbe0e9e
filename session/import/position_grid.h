// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "haarlight/session/session.h"

/// @file
/// Lights on a regular flat grid, detected from their positions: needed for Haar bases over the
/// lights of an imported capture.

namespace haarlight::session {

struct PositionGrid {
  int rows = 0;
  int cols = 0;
  /// (rows * cols): the list index of the light at each grid position, row by row. As listed
  /// where some corner and direction makes that the order; otherwise the first row at the
  /// greatest y, x increasing along it.
  std::vector<int> order;
};

/// The grid of at least 2 x 2 that the positions form: rows and columns at right angles, evenly
/// spaced to a quarter of their pitch, flat to the same, one light at each position. Nothing:
/// they form none, they are directions, or more than 16384.
[[nodiscard]] std::optional<PositionGrid> find_position_grid(
    std::span<const SessionLight> lights);

}  // namespace haarlight::session
