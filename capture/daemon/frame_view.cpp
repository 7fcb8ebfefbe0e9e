// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/frame_view.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdlib>

#include "capture/daemon/preview_png.h"
#include "haarlight/core/error.h"
#include "session/clip_level.h"

namespace haarlight::capture {

namespace {

/// Red, green or blue (0, 1, 2) of the four pixels of a Bayer cell, row by row.
std::array<int, 4> colours_of(BayerPattern bayer) {
  switch (bayer) {
    case BayerPattern::none:
      return {0, 0, 0, 0};
    case BayerPattern::rggb:
      return {0, 1, 1, 2};
    case BayerPattern::bggr:
      return {2, 1, 1, 0};
    case BayerPattern::grbg:
      return {1, 0, 2, 1};
    case BayerPattern::gbrg:
      return {1, 2, 0, 1};
  }
  return {0, 0, 0, 0};
}

void require_inside(ImageView<const std::uint16_t> words, const PixelRectangle& region) {
  HAARLIGHT_EXPECTS(region.x >= 0 && region.y >= 0 && region.width >= 1 && region.height >= 1 &&
                        region.x <= words.width() - region.width &&
                        region.y <= words.height() - region.height,
                    "a region of the frame");
}

/// Beyond the edge the frame is mirrored about its last pixel, which preserves the Bayer
/// pattern.
int mirrored(int i, int n) {
  if (n == 1) {
    return 0;
  }
  const int at = i < 0 ? -i : i;
  return at < n ? at : 2 * (n - 1) - at;
}

double smoothed(ImageView<const std::uint16_t> words, int y, int x) {
  double sum = 0.0;
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      const double weight = (dy == 0 ? 2.0 : 1.0) * (dx == 0 ? 2.0 : 1.0);
      sum += weight * words(mirrored(y + dy, words.height()), mirrored(x + dx, words.width()));
    }
  }
  return sum / 16.0;
}

/// The smallest integer word at or above `level`.
int first_word_at(double level) {
  return static_cast<int>(std::clamp(std::ceil(level), 0.0, 65536.0));
}

/// Sums over neighbouring pairs of one colour plane.
struct PairSums {
  std::uint64_t squares = 0;  ///< of the differences, DN^2
  std::uint64_t words = 0;    ///< both of each pair
  std::uint64_t n = 0;
  std::uint64_t n_all = 0;

  /// Every `step`-th word of two rows, or of one row and the same row shifted.
  void add(const std::uint16_t* a, const std::uint16_t* b, int n_words, int step, int clip) {
    std::uint64_t row_squares = 0;
    std::uint64_t row_words = 0;
    std::uint32_t row_n = 0;
    for (int i = 0; i < n_words; i += step) {
      const int first = a[i];
      const int second = b[i];
      const bool is_used = first < clip && second < clip;
      const auto difference =
          static_cast<std::uint32_t>(is_used ? std::abs(first - second) : 0);
      row_squares += std::uint64_t{difference} * difference;
      row_words += is_used ? static_cast<std::uint32_t>(first + second) : 0U;
      row_n += is_used ? 1U : 0U;
    }
    squares += row_squares;
    words += row_words;
    n += row_n;
    n_all += static_cast<std::uint64_t>((n_words + step - 1) / step);
  }
};

}  // namespace

WordScale word_scale(const CameraSpec& camera) {
  return {.black_dn = camera.noise.black_dn,
          .clip_dn = session::clip_level(camera),
          .white_dn = std::exp2(camera.bits) - 1.0,
          .bayer = camera.bayer,
          .noise = camera.noise};
}

Image<std::uint8_t> make_crop_codes(ImageView<const std::uint16_t> words,
                                    const WordScale& scale, const PixelRectangle& region) {
  require_inside(words, region);
  const GreyCurve curve(scale.black_dn, scale.clip_dn);
  Image<std::uint8_t> codes(region.height, region.width, 1);
  for (int y = 0; y < region.height; ++y) {
    for (int x = 0; x < region.width; ++x) {
      const std::uint16_t word = words(region.y + y, region.x + x);
      codes(y, x) = word >= scale.clip_dn    ? kCodeSaturated
                    : word <= scale.black_dn ? kCodeBlack
                    : scale.bayer == BayerPattern::none
                        ? curve(word)
                        : curve(smoothed(words, region.y + y, region.x + x));
    }
  }
  return codes;
}

std::vector<ColourCounts> count_words(ImageView<const std::uint16_t> words,
                                      const WordScale& scale, const PixelRectangle& region) {
  require_inside(words, region);
  const bool is_bayer = scale.bayer != BayerPattern::none;
  const std::array<int, 4> colours = colours_of(scale.bayer);
  std::vector<ColourCounts> counts(is_bayer ? 3 : 1);
  for (std::size_t c = 0; c < counts.size(); ++c) {
    constexpr std::array<const char*, 3> kNames{"red", "green", "blue"};
    counts[c].colour = is_bayer ? kNames.at(c) : "grey";
  }
  std::vector<std::uint8_t> bin_of(65536);
  const double bins_a_word = kHistogramBins / (scale.white_dn + 1.0);
  for (std::size_t word = 0; word < bin_of.size(); ++word) {
    bin_of[word] = static_cast<std::uint8_t>(std::min(static_cast<double>(word) * bins_a_word,
                                                      static_cast<double>(kHistogramBins - 1)));
  }
  const int clip = first_word_at(scale.clip_dn);
  std::vector<std::uint64_t> sums(counts.size(), 0);
  const int step = is_bayer ? 2 : 1;
  for (int y = region.y; y < region.y + region.height; ++y) {
    const auto row = words.row(y);
    for (int x0 = region.x; x0 < std::min(region.x + step, region.x + region.width); ++x0) {
      const auto c = static_cast<std::size_t>(
          colours[2U * (static_cast<unsigned>(y) & 1U) + (static_cast<unsigned>(x0) & 1U)]);
      ColourCounts& counted = counts[c];
      for (int x = x0; x < region.x + region.width; x += step) {
        const std::uint16_t word = row[static_cast<std::size_t>(x)];
        ++counted.bins[bin_of[word]];
        ++counted.n;
        counted.n_black += word <= scale.black_dn ? 1U : 0U;
        counted.n_saturated += word >= clip ? 1U : 0U;
        sums[c] += word;
      }
    }
  }
  for (std::size_t c = 0; c < counts.size(); ++c) {
    counts[c].mean_dn = counts[c].n == 0
                            ? 0.0
                            : static_cast<double>(sums[c]) / static_cast<double>(counts[c].n);
  }
  return counts;
}

Sharpness measure_sharpness(ImageView<const std::uint16_t> words, const WordScale& scale,
                            const PixelRectangle& region) {
  require_inside(words, region);
  const int step = scale.bayer == BayerPattern::none ? 1 : 2;  // to the next of this colour
  const int clip = first_word_at(scale.clip_dn);
  const int end_x = region.x + region.width;
  std::array<PairSums, 4> planes{};
  for (int y = region.y; y < region.y + region.height; ++y) {
    const std::uint16_t* row = words.row(y).data();
    const bool has_below = y + step < region.y + region.height;
    const std::uint16_t* below = has_below ? words.row(y + step).data() : row;
    for (int x = region.x; x < std::min(region.x + step, end_x); ++x) {
      PairSums& plane = planes[step == 1 ? 0 : static_cast<std::size_t>(2 * (y & 1) + (x & 1))];
      if (x + step < end_x) {
        plane.add(row + x, row + x + step, end_x - step - x, step, clip);
      }
      if (has_below) {
        plane.add(row + x, below + x, end_x - x, step, clip);
      }
    }
  }
  const bool is_noise_known = scale.noise.full_well_e > 0.0 || scale.noise.read_e > 0.0;
  const double e_per_dn = scale.noise.gain_e_per_dn;
  double squares = 0.0;
  double noise = 0.0;
  double level_squares = 0.0;
  double levels = 0.0;
  std::uint64_t n = 0;
  std::uint64_t n_all = 0;
  for (const PairSums& plane : planes) {
    if (plane.n > 0) {
      const auto pairs = static_cast<double>(plane.n);
      const double level = static_cast<double>(plane.words) / (2.0 * pairs) - scale.black_dn;
      squares += static_cast<double>(plane.squares);
      level_squares += pairs * level * level;
      levels += pairs * level;
      if (is_noise_known) {  // the variance of both words: read noise and shot noise
        const double read_dn = scale.noise.read_e / e_per_dn;
        noise += 2.0 * pairs * (read_dn * read_dn + std::max(0.0, level) / e_per_dn);
      }
    }
    n += plane.n;
    n_all += plane.n_all;
  }
  Sharpness sharpness;
  if (n == 0 || !(levels > 0.0)) {
    return sharpness;
  }
  sharpness.value = std::sqrt(std::max(0.0, squares - noise) / level_squares);
  sharpness.noise = std::sqrt(noise / level_squares);
  sharpness.fraction_used = static_cast<double>(n) / static_cast<double>(n_all);
  sharpness.level_dn = levels / static_cast<double>(n);
  return sharpness;
}

}  // namespace haarlight::capture
