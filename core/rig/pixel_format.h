// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <string>
#include <string_view>

#include "haarlight/core/rig/rig.h"

/// @file
/// The pixel formats that a camera may deliver, by V4L2's four-letter codes: how many bits are
/// significant, how they are packed, which Bayer phase, and whether they are linear in light.

namespace haarlight {

/// How samples are laid out in a row's bytes. `capture/camera/pixel_unpack.h` turns each into
/// words.
enum class PixelPacking {
  bytes,        ///< one byte per sample
  words_le,     ///< 16 bits per sample, low byte first, value in the low bits
  words_be,     ///< 16 bits per sample, high byte first
  mipi10,       ///< 4 samples in 5 bytes: the high 8 bits of each, then the low 2 of all four
  mipi12,       ///< 2 samples in 3 bytes
  mipi14,       ///< 4 samples in 7 bytes
  bits10,       ///< 10 bits per sample without gaps, most significant bit first
  ipu3,         ///< 25 samples of 10 bits in 32 bytes, least significant bit first
  luma_even,    ///< Y at even bytes, chroma in between: YUYV
  luma_odd,     ///< Y at odd bytes: UYVY
  luma_plane,   ///< a plane of Y bytes first, then chroma: NV12
  motion_jpeg,  ///< one JPEG picture per frame
};

/// What the samples may be used for.
enum class PixelUse {
  measurement,  ///< linear in light
  display,      ///< through the camera's own tone curve: kept, but developed only when allowed
  preview,      ///< lossy: for viewing only, never stored
};

struct PixelFormat {
  std::string_view
      fourcc;  ///< four letters, trailing blanks kept; "-BE" appended to big-endian ones
  std::string_view name;  ///< for messages
  int bits = 0;           ///< significant bits per word
  BayerPattern bayer = BayerPattern::none;
  PixelPacking packing = PixelPacking::bytes;
  PixelUse use = PixelUse::measurement;
};

/// Every format that haarlight reads, measurement ones first.
[[nodiscard]] std::span<const PixelFormat> pixel_formats() noexcept;
/// The format of these letters (trailing blanks may be missing), or null.
[[nodiscard]] const PixelFormat* find_pixel_format(std::string_view fourcc) noexcept;
/// What the samples of a camera's frames may be used for: for V4L2 cameras by format; for the
/// others, whose bridge delivers words, measurement.
[[nodiscard]] PixelUse pixel_use(const CameraSpec& camera) noexcept;

}  // namespace haarlight
