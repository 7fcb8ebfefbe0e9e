// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <string>
#include <string_view>

#include "core/rig/rig.h"

/// @file
/// The pixel formats that a camera may deliver, by the four letters V4L2 gives them: how many
/// bits count, how they are packed, which Bayer phase, and whether they are linear in light.

namespace haarlight {

/// How samples lie in a row's bytes. `capture/camera/pixel_unpack.h` turns each into words.
enum class PixelPacking {
  bytes,        ///< one byte a sample
  words_le,     ///< 16 bits a sample, low byte first, value in the low bits
  words_be,     ///< 16 bits a sample, high byte first
  mipi10,       ///< 4 samples in 5 bytes: the high 8 bits of each, then the low 2 of all four
  mipi12,       ///< 2 samples in 3 bytes
  mipi14,       ///< 4 samples in 7 bytes
  bits10,       ///< 10 bits a sample without gaps, most significant bit first
  ipu3,         ///< 25 samples of 10 bits in 32 bytes, least significant bit first
  luma_even,    ///< Y at even bytes, colour between: YUYV
  luma_odd,     ///< Y at odd bytes: UYVY
  luma_plane,   ///< a plane of Y bytes first, colour behind it: NV12
  motion_jpeg,  ///< a JPEG picture a frame
};

/// What the samples may be used for.
enum class PixelUse {
  measurement,  ///< linear in light
  display,      ///< through a curve of the camera's own: kept, but developed only when allowed
  preview,      ///< lossy: for looking only, never stored
};

struct PixelFormat {
  std::string_view
      fourcc;             ///< four letters, trailing blanks kept; "-BE" behind big-endian ones
  std::string_view name;  ///< for people
  int bits = 0;           ///< significant bits of a word
  BayerPattern bayer = BayerPattern::none;
  PixelPacking packing = PixelPacking::bytes;
  PixelUse use = PixelUse::measurement;
};

/// Every format that haarlight reads, measurement ones first.
[[nodiscard]] std::span<const PixelFormat> pixel_formats() noexcept;
/// The format of these letters (trailing blanks may be missing), or null.
[[nodiscard]] const PixelFormat* find_pixel_format(std::string_view fourcc) noexcept;
/// What the samples of a camera's frames may be used for: by its format for V4L2 cameras,
/// measurement for the others, whose bridge delivers words.
[[nodiscard]] PixelUse pixel_use(const CameraSpec& camera) noexcept;

}  // namespace haarlight
