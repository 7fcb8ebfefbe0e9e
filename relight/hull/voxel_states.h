// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

namespace haarlight::relight {

/// What a voxel of a shadow hull is. The order is that of the file format.
enum class VoxelState : std::uint8_t {
  empty,   ///< seen lit, or seen through by a camera
  matter,  ///< seen by at least three quarters of the lights, and lit by none of them
  /// Seen by fewer and lit by none, or hardly seen, but enclosed by matter or needed; taken as
  /// matter in the picture, as empty in the upper bound.
  assumed_full,
  assumed_empty,  ///< hardly seen; taken as empty in the picture, as matter in the lower bound
};

/// Whether the hull in the picture has it.
[[nodiscard]] constexpr bool is_taken_as_matter(VoxelState state) {
  return state == VoxelState::matter || state == VoxelState::assumed_full;
}

}  // namespace haarlight::relight
