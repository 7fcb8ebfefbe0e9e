// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/develop/demosaic.h"

#include <algorithm>
#include <cmath>

#include "haarlight/core/error.h"

namespace haarlight::session {

namespace {

/// Mirrors an index about the outermost samples: -1 -> 1, n -> n - 2.
int mirror(int i, int n) {
  if (i < 0) {
    i = -i;
  }
  return i >= n ? 2 * (n - 1) - i : i;
}

/// Reads a one-channel picture with mirrored borders.
class Mirrored {
 public:
  explicit Mirrored(ImageView<const float> view) : view_(view) {}
  float operator()(int y, int x) const {
    return view_(std::clamp(mirror(y, view_.height()), 0, view_.height() - 1),
                 std::clamp(mirror(x, view_.width()), 0, view_.width() - 1));
  }

 private:
  ImageView<const float> view_;
};

/// Mean of the neighbours of `colour` in the 3 x 3 window around a sample of another colour:
/// the cross for green, otherwise the row, the column or the diagonals.
template <class Sample>
float neighbour_mean(const Sample& sample, BayerPattern pattern, int y, int x, int colour) {
  if (bayer_colour(pattern, y, x + 1) == colour) {
    const float row = 0.5F * (sample(y, x - 1) + sample(y, x + 1));
    if (bayer_colour(pattern, y + 1, x) == colour) {
      return 0.5F * (row + 0.5F * (sample(y - 1, x) + sample(y + 1, x)));
    }
    return row;
  }
  if (bayer_colour(pattern, y + 1, x) == colour) {
    return 0.5F * (sample(y - 1, x) + sample(y + 1, x));
  }
  return 0.25F * ((sample(y - 1, x - 1) + sample(y - 1, x + 1)) +
                  (sample(y + 1, x - 1) + sample(y + 1, x + 1)));
}

/// Green everywhere [Hamilton97]: along the direction in which green and the sample's own
/// colour change less, corrected by the own colour's second difference.
Image<float> interpolate_green(ImageView<const float> mosaic, BayerPattern pattern) {
  const Mirrored s(mosaic);
  Image<float> green(mosaic.height(), mosaic.width(), 1);
  for (int y = 0; y < mosaic.height(); ++y) {
    for (int x = 0; x < mosaic.width(); ++x) {
      if (bayer_colour(pattern, y, x) == 1) {
        green(y, x) = mosaic(y, x);
        continue;
      }
      const float bend_h = 2.0F * s(y, x) - s(y, x - 2) - s(y, x + 2);
      const float bend_v = 2.0F * s(y, x) - s(y - 2, x) - s(y + 2, x);
      const float change_h = std::abs(s(y, x - 1) - s(y, x + 1)) + std::abs(bend_h);
      const float change_v = std::abs(s(y - 1, x) - s(y + 1, x)) + std::abs(bend_v);
      const float along_h = 0.5F * (s(y, x - 1) + s(y, x + 1)) + 0.25F * bend_h;
      const float along_v = 0.5F * (s(y - 1, x) + s(y + 1, x)) + 0.25F * bend_v;
      if (change_h < change_v) {
        green(y, x) = along_h;
      } else if (change_v < change_h) {
        green(y, x) = along_v;
      } else {
        green(y, x) = 0.5F * (along_h + along_v);
      }
    }
  }
  return green;
}

Image<float> demosaic_edge_aware(ImageView<const float> mosaic, BayerPattern pattern) {
  const Image<float> green = interpolate_green(mosaic, pattern);
  const Mirrored s(mosaic);
  const Mirrored g(green.view());
  const auto difference = [&](int y, int x) { return s(y, x) - g(y, x); };
  Image<float> result(mosaic.height(), mosaic.width(), 3);
  for (int y = 0; y < mosaic.height(); ++y) {
    for (int x = 0; x < mosaic.width(); ++x) {
      const int own = bayer_colour(pattern, y, x);
      for (int c = 0; c < 3; ++c) {
        if (c == own) {
          result(y, x, c) = mosaic(y, x);
        } else if (c == 1) {
          result(y, x, c) = green(y, x);
        } else {
          result(y, x, c) = green(y, x) + neighbour_mean(difference, pattern, y, x, c);
        }
      }
    }
  }
  return result;
}

Image<float> demosaic_bilinear(ImageView<const float> mosaic, BayerPattern pattern) {
  const Mirrored s(mosaic);
  Image<float> result(mosaic.height(), mosaic.width(), 3);
  for (int y = 0; y < mosaic.height(); ++y) {
    for (int x = 0; x < mosaic.width(); ++x) {
      const int own = bayer_colour(pattern, y, x);
      for (int c = 0; c < 3; ++c) {
        result(y, x, c) = c == own ? mosaic(y, x) : neighbour_mean(s, pattern, y, x, c);
      }
    }
  }
  return result;
}

}  // namespace

int bayer_colour(BayerPattern pattern, int y, int x) noexcept {
  // Red is at (ry, rx) of each 2 x 2 cell, blue diagonally opposite, green elsewhere.
  const int ry = pattern == BayerPattern::bggr || pattern == BayerPattern::gbrg ? 1 : 0;
  const int rx = pattern == BayerPattern::bggr || pattern == BayerPattern::grbg ? 1 : 0;
  const bool is_red_row = ((y ^ ry) & 1) == 0;
  const bool is_red_column = ((x ^ rx) & 1) == 0;
  if (is_red_row != is_red_column) {
    return 1;
  }
  return is_red_row ? 0 : 2;
}

Image<float> demosaic(ImageView<const float> mosaic, BayerPattern pattern, Demosaic method) {
  HAARLIGHT_EXPECTS(mosaic.channels() == 1 && mosaic.height() >= 2 && mosaic.width() >= 2,
                    "a mosaic of at least 2 x 2");
  HAARLIGHT_EXPECTS(pattern != BayerPattern::none && method != Demosaic::none,
                    "a Bayer pattern and a method");
  return method == Demosaic::bilinear ? demosaic_bilinear(mosaic, pattern)
                                      : demosaic_edge_aware(mosaic, pattern);
}

}  // namespace haarlight::session
