// SPDX-License-Identifier: Apache-2.0
#include "core/rig/pixel_format.h"

#include <algorithm>
#include <array>

namespace haarlight {

namespace {

using enum PixelPacking;
using enum PixelUse;
using enum BayerPattern;

// Letters as in linux/videodev2.h, whose documentation defines each layout; Y12P and Y14P were
// added after Debian 12's kernel.
constexpr std::array kFormats{
    PixelFormat{"GREY", "grey 8 bit", 8, none, bytes, measurement},
    PixelFormat{"Y10 ", "grey 10 bit", 10, none, words_le, measurement},
    PixelFormat{"Y12 ", "grey 12 bit", 12, none, words_le, measurement},
    PixelFormat{"Y14 ", "grey 14 bit", 14, none, words_le, measurement},
    PixelFormat{"Y16 ", "grey 16 bit", 16, none, words_le, measurement},
    PixelFormat{"Y16 -BE", "grey 16 bit, high byte first", 16, none, words_be, measurement},
    PixelFormat{"Y10P", "grey 10 bit, MIPI packed", 10, none, mipi10, measurement},
    PixelFormat{"Y12P", "grey 12 bit, MIPI packed", 12, none, mipi12, measurement},
    PixelFormat{"Y14P", "grey 14 bit, MIPI packed", 14, none, mipi14, measurement},
    PixelFormat{"Y10B", "grey 10 bit, packed without gaps", 10, none, bits10, measurement},
    PixelFormat{"ip3y", "grey 10 bit, IPU3 packed", 10, none, ipu3, measurement},
    PixelFormat{"BA81", "Bayer BGGR 8 bit", 8, bggr, bytes, measurement},
    PixelFormat{"GBRG", "Bayer GBRG 8 bit", 8, gbrg, bytes, measurement},
    PixelFormat{"GRBG", "Bayer GRBG 8 bit", 8, grbg, bytes, measurement},
    PixelFormat{"RGGB", "Bayer RGGB 8 bit", 8, rggb, bytes, measurement},
    PixelFormat{"BG10", "Bayer BGGR 10 bit", 10, bggr, words_le, measurement},
    PixelFormat{"GB10", "Bayer GBRG 10 bit", 10, gbrg, words_le, measurement},
    PixelFormat{"BA10", "Bayer GRBG 10 bit", 10, grbg, words_le, measurement},
    PixelFormat{"RG10", "Bayer RGGB 10 bit", 10, rggb, words_le, measurement},
    PixelFormat{"pBAA", "Bayer BGGR 10 bit, MIPI packed", 10, bggr, mipi10, measurement},
    PixelFormat{"pGAA", "Bayer GBRG 10 bit, MIPI packed", 10, gbrg, mipi10, measurement},
    PixelFormat{"pgAA", "Bayer GRBG 10 bit, MIPI packed", 10, grbg, mipi10, measurement},
    PixelFormat{"pRAA", "Bayer RGGB 10 bit, MIPI packed", 10, rggb, mipi10, measurement},
    PixelFormat{"ip3b", "Bayer BGGR 10 bit, IPU3 packed", 10, bggr, ipu3, measurement},
    PixelFormat{"ip3g", "Bayer GBRG 10 bit, IPU3 packed", 10, gbrg, ipu3, measurement},
    PixelFormat{"ip3G", "Bayer GRBG 10 bit, IPU3 packed", 10, grbg, ipu3, measurement},
    PixelFormat{"ip3r", "Bayer RGGB 10 bit, IPU3 packed", 10, rggb, ipu3, measurement},
    PixelFormat{"BG12", "Bayer BGGR 12 bit", 12, bggr, words_le, measurement},
    PixelFormat{"GB12", "Bayer GBRG 12 bit", 12, gbrg, words_le, measurement},
    PixelFormat{"BA12", "Bayer GRBG 12 bit", 12, grbg, words_le, measurement},
    PixelFormat{"RG12", "Bayer RGGB 12 bit", 12, rggb, words_le, measurement},
    PixelFormat{"pBCC", "Bayer BGGR 12 bit, MIPI packed", 12, bggr, mipi12, measurement},
    PixelFormat{"pGCC", "Bayer GBRG 12 bit, MIPI packed", 12, gbrg, mipi12, measurement},
    PixelFormat{"pgCC", "Bayer GRBG 12 bit, MIPI packed", 12, grbg, mipi12, measurement},
    PixelFormat{"pRCC", "Bayer RGGB 12 bit, MIPI packed", 12, rggb, mipi12, measurement},
    PixelFormat{"BG14", "Bayer BGGR 14 bit", 14, bggr, words_le, measurement},
    PixelFormat{"GB14", "Bayer GBRG 14 bit", 14, gbrg, words_le, measurement},
    PixelFormat{"GR14", "Bayer GRBG 14 bit", 14, grbg, words_le, measurement},
    PixelFormat{"RG14", "Bayer RGGB 14 bit", 14, rggb, words_le, measurement},
    PixelFormat{"pBEE", "Bayer BGGR 14 bit, MIPI packed", 14, bggr, mipi14, measurement},
    PixelFormat{"pGEE", "Bayer GBRG 14 bit, MIPI packed", 14, gbrg, mipi14, measurement},
    PixelFormat{"pgEE", "Bayer GRBG 14 bit, MIPI packed", 14, grbg, mipi14, measurement},
    PixelFormat{"pREE", "Bayer RGGB 14 bit, MIPI packed", 14, rggb, mipi14, measurement},
    PixelFormat{"BYR2", "Bayer BGGR 16 bit", 16, bggr, words_le, measurement},
    PixelFormat{"GB16", "Bayer GBRG 16 bit", 16, gbrg, words_le, measurement},
    PixelFormat{"GR16", "Bayer GRBG 16 bit", 16, grbg, words_le, measurement},
    PixelFormat{"RG16", "Bayer RGGB 16 bit", 16, rggb, words_le, measurement},
    PixelFormat{"YUYV", "YUYV, its grey only", 8, none, luma_even, display},
    PixelFormat{"YVYU", "YVYU, its grey only", 8, none, luma_even, display},
    PixelFormat{"UYVY", "UYVY, its grey only", 8, none, luma_odd, display},
    PixelFormat{"VYUY", "VYUY, its grey only", 8, none, luma_odd, display},
    PixelFormat{"NV12", "NV12, its grey only", 8, none, luma_plane, display},
    PixelFormat{"NV21", "NV21, its grey only", 8, none, luma_plane, display},
    PixelFormat{"NV16", "NV16, its grey only", 8, none, luma_plane, display},
    PixelFormat{"NM12", "NV12 in two planes, its grey only", 8, none, luma_plane, display},
    PixelFormat{"MJPG", "Motion JPEG, its grey only", 8, none, motion_jpeg, preview},
    PixelFormat{"JPEG", "JPEG, its grey only", 8, none, motion_jpeg, preview},
};

std::string_view trimmed(std::string_view letters) {
  const std::size_t last = letters.find_last_not_of(' ');
  return last == std::string_view::npos ? std::string_view{} : letters.substr(0, last + 1);
}

}  // namespace

std::span<const PixelFormat> pixel_formats() noexcept { return kFormats; }

const PixelFormat* find_pixel_format(std::string_view fourcc) noexcept {
  const auto* const found = std::find_if(
      kFormats.begin(), kFormats.end(),
      [&](const PixelFormat& format) { return trimmed(format.fourcc) == trimmed(fourcc); });
  return found == kFormats.end() ? nullptr : &*found;
}

PixelUse pixel_use(const CameraSpec& camera) noexcept {
  const PixelFormat* format =
      camera.kind == CameraKind::v4l2 ? find_pixel_format(camera.format) : nullptr;
  return format == nullptr ? measurement : format->use;
}

}  // namespace haarlight
