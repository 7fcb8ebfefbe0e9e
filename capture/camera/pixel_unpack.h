// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "core/image.h"
#include "core/rig/pixel_format.h"

/// @file
/// A camera's packed rows to 16-bit sensor words. Layouts are those of linux/videodev2.h's
/// documentation; core/rig/pixel_format.h lists the formats. Pure.
/// Cost: bench/capture; plain loops, each several times faster than a camera delivers.

namespace haarlight {

/// Bytes that a row of `width` samples needs, without the driver's padding; whole groups, as
/// MIPI sends them. 0 for motion_jpeg, whose pictures have no rows.
[[nodiscard]] std::size_t packed_row_bytes(PixelPacking packing, int width) noexcept;

/// Bytes that a frame needs so that every sample can be read: the last row without padding.
[[nodiscard]] std::size_t packed_frame_bytes(PixelPacking packing, int width, int height,
                                             std::size_t stride) noexcept;

/// Unpacks a frame; motion_jpeg is decode_grey_jpeg's (capture/camera/grey_jpeg.h).
/// @param source  at least packed_frame_bytes(...) bytes, `stride` from row to row
/// @param words   (height, width, 1)
/// @return        the OR of all words: above 2^bits - 1 the driver breaks its format (samples
///                shifted into the high bits)
/// @throws ContractViolation  too few bytes, a stride below a row's bytes
std::uint16_t unpack_pixels(PixelPacking packing, std::span<const std::byte> source,
                            std::size_t stride, ImageView<std::uint16_t> words);

}  // namespace haarlight
