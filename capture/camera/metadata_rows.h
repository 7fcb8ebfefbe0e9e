// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>

#include "haarlight/core/image.h"

/// @file
/// Embedded metadata rows: the light's tag as black and white blocks in the extra rows below a
/// camera's active area. The simulated camera writes what was really lit, a test reads it back
/// from the stored frame.
///
/// 96 bits, most significant first, in raster order of square blocks:
///
///     sync 0xB2 | tag (32) | flags (8) | ~tag (32) | CRC-16/CCITT-FALSE of tag and flags (16)
///
/// Block side: the largest b with floor(width / b) * floor(rows / b) >= 96; at least 2 pixels.
/// Blocks fill whole rows of floor(width / b); everything to the right and below is black.

namespace haarlight::capture {

/// What light the frame saw.
struct FrameTag {
  std::uint32_t tag = 0;  ///< of the pattern lit; of the last one when mixed; 0 = all off
  bool is_mixed = false;  ///< the light changed, or was not settled, during some row's exposure
  friend bool operator==(const FrameTag&, const FrameTag&) = default;
};

/// Side of a block in pixels, 0 when the rows are too small for 96 blocks of 2 x 2. Pure.
[[nodiscard]] int tag_block_side(int width, int n_rows) noexcept;

/// Draws the tag over all of `rows`.
/// @param rows   (metadata rows, width, 1), see tag_block_side
/// @param black  word of a 0 bit
/// @param white  word of a 1 bit; well above black
void encode_metadata_rows(ImageView<std::uint16_t> rows, FrameTag tag, std::uint16_t black,
                          std::uint16_t white);

/// Reads the tag back: block means against the midpoint of the darkest and the brightest block.
/// Nothing when the sync word, complement or CRC is wrong: no tag, damaged, or too noisy.
/// Per-pixel rms noise up to a sixth of (white - black) is read without error (tests/capture).
/// Pure.
[[nodiscard]] std::optional<FrameTag> decode_metadata_rows(ImageView<const std::uint16_t> rows);

}  // namespace haarlight::capture
