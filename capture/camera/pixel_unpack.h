// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "core/rig/pixel_format.h"
#include "haarlight/core/image.h"

/// @file
/// Unpacks a camera's packed rows into 16-bit sensor words. Layouts as documented for
/// linux/videodev2.h; core/rig/pixel_format.h lists the formats. Pure.
/// Cost: bench/capture; plain loops, each several times faster than a camera delivers.

namespace haarlight::capture {

/// Bytes in a row of `width` samples, without the driver's padding; whole groups, as MIPI sends
/// them. 0 for motion_jpeg, whose pictures have no rows.
[[nodiscard]] std::size_t packed_row_bytes(PixelPacking packing, int width) noexcept;

/// Bytes a frame must have for every sample to be readable: the last row without padding.
[[nodiscard]] std::size_t packed_frame_bytes(PixelPacking packing, int width, int height,
                                             std::size_t stride) noexcept;

/// Unpacks a frame; motion_jpeg is decoded by decode_grey_jpeg (capture/camera/grey_jpeg.h).
/// @param source  at least packed_frame_bytes(...) bytes, row pitch `stride`
/// @param words   (height, width, 1)
/// @return        the OR of all words: above 2^bits - 1 the driver violates its format (samples
///                shifted into the high bits)
/// @throws ContractViolation  too few bytes, or a stride shorter than a row
std::uint16_t unpack_pixels(PixelPacking packing, std::span<const std::byte> source,
                            std::size_t stride, ImageView<std::uint16_t> words);

}  // namespace haarlight::capture
