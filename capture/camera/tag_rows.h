// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>

#include "core/image.h"

/// @file
/// The light's tag written as black and white blocks into the extra rows below a camera's
/// active area: the simulated camera writes what was truly lit, a test reads it from the stored
/// frame.
///
/// 96 bits, most significant first, in raster order of square blocks:
///
///     sync 0xB2 | tag (32) | flags (8) | ~tag (32) | CRC-16/CCITT-FALSE of tag and flags (16)
///
/// Block side: the largest b with floor(width / b) * floor(rows / b) >= 96; at least 2 pixels.
/// Blocks fill whole rows of floor(width / b); everything to the right and below is black.

namespace haarlight {

/// What the frame saw.
struct FrameTag {
  std::uint32_t tag = 0;  ///< of the pattern lit; of the last one when mixed; 0 = all off
  bool is_mixed = false;  ///< the light changed, or was not settled, in any row's exposure
  friend bool operator==(const FrameTag&, const FrameTag&) = default;
};

/// Side of a block in pixels, 0 when the rows are too small for 96 blocks of 2 x 2. Pure.
[[nodiscard]] int tag_block_side(int width, int n_rows) noexcept;

/// Draws the tag over all of `rows`.
/// @param rows   (tag rows, width, 1), see tag_block_side
/// @param black  word of a 0 bit
/// @param white  word of a 1 bit; well above black
void encode_tag_rows(ImageView<std::uint16_t> rows, FrameTag tag, std::uint16_t black,
                     std::uint16_t white);

/// Reads the tag back: block means against the middle of the darkest and the brightest block.
/// Nothing when sync word, complement or CRC do not hold: no tag, damaged, or too noisy. Noise
/// up to a sixth of (white - black) rms a pixel is read without error (tests/capture). Pure.
[[nodiscard]] std::optional<FrameTag> decode_tag_rows(ImageView<const std::uint16_t> rows);

}  // namespace haarlight
