// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "render/volume/orientation.h"
#include "render/volume/volume_view.h"

/// @file
/// Which cells obstruct which across gaps of a mesh: holes, its parts, hollows, and faces that meet only
/// in part.

namespace haarlight::render {

/// A ray leaves `nearer` and enters `farther` next, or later.
struct Obstruction {
  std::uint32_t nearer = 0;
  std::uint32_t farther = 0;
  friend bool operator==(const Obstruction& a, const Obstruction& b) = default;
};

/// Of each face by which rays leave a cell and each by which they enter another, whose insides overlap
/// on the picture, exactly: whether the first is nearer where they do. Convex cells that do not overlap
/// have one order there; of faces that touch, the cell that rays leave is nearer.
/// @param is_shown  of each cell: others count as absent
/// @param is_exit   of each face of the mesh: whether rays leave their cells by it
/// @return  sorted, each once
[[nodiscard]] std::vector<Obstruction> boundary_relations(const VolumeView& view,
                                                          std::span<const char> is_shown,
                                                          std::span<const char> is_exit,
                                                          Orientation& orientation);

}  // namespace haarlight::render
