// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "haarlight/core/image.h"

/// @file
/// From one picture per light to the stack's order, where a pixel's lights are neighbours.

namespace haarlight::session {

/// Lights whose values are written together: one cache line.
inline constexpr std::size_t kLightBlock = 16;

/// Where pictures' values go: (channels, rows, width, n_lights).
struct StackRows {
  float* values = nullptr;
  std::size_t rows = 0;
  std::size_t n_lights = 0;
};

/// Writes rows [skip, skip + to.rows) of some neighbouring lights' pictures.
/// @param pictures  at most kLightBlock, of one shape (height, width, channels)
/// @param first     light of the first; each block of kLightBlock is written by one thread
void interleave(std::span<const Image<float>> pictures, std::size_t skip, std::size_t first,
                const StackRows& to);

/// The same for marks, most of which are empty pictures or rows of zeros.
/// @param marks  of every light; (height, width, channels), or empty
/// @return  (channels, rows, width, n_lights)
[[nodiscard]] std::vector<std::uint8_t> interleave_marks(
    const std::vector<Image<std::uint8_t>>& marks, std::size_t skip, std::size_t rows,
    std::size_t width, std::size_t channels);

}  // namespace haarlight::session
