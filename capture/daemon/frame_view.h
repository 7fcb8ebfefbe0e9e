// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "haarlight/core/image.h"
#include "haarlight/core/picture/picture_rectangle.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// What somebody who aims, focuses or sets the exposure needs to see of a frame's words: a crop
/// at the sensor's own pixels, counts of the words per colour, and how sharp it is. Pure.

namespace haarlight::capture {

/// How to interpret a frame's words.
struct WordScale {
  double black_dn = 0.0;      ///< words at or below it are black
  double clip_dn = 65535.0;   ///< words at or above it are saturated, see session/clip_level.h
  double white_dn = 65535.0;  ///< the largest word
  BayerPattern bayer = BayerPattern::none;
  SensorNoise noise = {};  ///< full_well_e and read_e both 0: unknown
};
/// For a camera as described in its rig file.
[[nodiscard]] WordScale word_scale(const CameraSpec& camera);

/// The region's pixels one by one as codes of capture/daemon/preview_png.h. A Bayer frame's
/// greys are smoothed by [1 2 1; 2 4 2; 1 2 1] / 16, which weights its four colours alike at
/// every pixel, so that no chequerboard shows; the marks are those of the pixel's own word.
/// @pre the region lies in the frame and is not empty; scale.black_dn < scale.clip_dn
[[nodiscard]] Image<std::uint8_t> make_crop_codes(ImageView<const std::uint16_t> words,
                                                  const WordScale& scale,
                                                  const PixelRectangle& region);

inline constexpr int kHistogramBins = 256;

/// Histogram of the words of one colour. Bin i holds the words with floor(word * 256 / (white +
/// 1)) = i; larger words are counted in the last one.
struct ColourCounts {
  std::string colour;  ///< "grey", or "red", "green", "blue"
  std::array<std::uint64_t, kHistogramBins> bins{};
  std::uint64_t n = 0;
  std::uint64_t n_black = 0;
  std::uint64_t n_saturated = 0;
  double mean_dn = 0.0;  ///< 0 without pixels
};
/// One for a grey frame, three for a Bayer frame.
[[nodiscard]] std::vector<ColourCounts> count_words(ImageView<const std::uint16_t> words,
                                                    const WordScale& scale,
                                                    const PixelRectangle& region);

/// How sharp a region is: the root mean square difference of neighbouring pixels of one colour,
/// as a fraction of the mean level above black. The part that the camera's noise alone would
/// produce is subtracted, where the noise is known: the figure then depends on the picture, not
/// on its exposure. Pairs with a saturated pixel are left out.
struct Sharpness {
  double value = 0.0;          ///< 0: nothing beyond the noise, or nothing to measure
  double noise = 0.0;          ///< what noise alone would produce; 0 where unknown
  double fraction_used = 0.0;  ///< of the pairs; below 1 where pixels are saturated
  double level_dn = 0.0;       ///< mean above black of the unsaturated pixels
};
[[nodiscard]] Sharpness measure_sharpness(ImageView<const std::uint16_t> words,
                                          const WordScale& scale, const PixelRectangle& region);

}  // namespace haarlight::capture
