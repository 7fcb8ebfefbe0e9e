// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

#include "haarlight/core/image.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// Small pictures for display with clipping marked exactly: an indexed PNG whose entries 0 ..
/// 253 are greys (sRGB curve from black to white), 254 is "at or below black" (blue) and 255
/// "saturated" (red). Only the .cpp includes zlib. [ISO 15948], indexed colour, no filter.

namespace haarlight::capture {

inline constexpr std::uint8_t kCodeWhitest = 253;
inline constexpr std::uint8_t kCodeBlack = 254;
inline constexpr std::uint8_t kCodeSaturated = 255;

/// From black to white on the sRGB curve, as codes 0 .. kCodeWhitest.
class GreyCurve {
 public:
  /// @pre black < white
  GreyCurve(double black, double white);
  [[nodiscard]] std::uint8_t operator()(double word) const;

 private:
  double black_;
  double scale_;
};

/// Sensor words as a smaller picture of codes, each the mean of a block of step x step words;
/// partial blocks at the right and lower edge. A block is saturated when any of its words is,
/// and black when all are: no clipped pixel is overlooked.
/// @param black  words at or below it are black; @param white  words at or above: saturated
/// @pre black < white, step >= 1
[[nodiscard]] Image<std::uint8_t> make_preview_codes(ImageView<const std::uint16_t> words,
                                                     double black, double white, int step);

/// The step that reduces the longer side to at most 640 pixels; for a Bayer frame that is
/// reduced an even one, so that each block holds all colours equally.
[[nodiscard]] int preview_step(int width, int height, BayerPattern bayer);

/// Fraction of codes that are saturated.
[[nodiscard]] double saturated_fraction_of(ImageView<const std::uint8_t> codes);

/// @throws Error(internal)  zlib failed
[[nodiscard]] std::string encode_preview_png(ImageView<const std::uint8_t> codes);

}  // namespace haarlight::capture
