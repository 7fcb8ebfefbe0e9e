// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/picture/picture_rectangle.h"

#include <algorithm>
#include <cstdio>

#include <fmt/format.h>

namespace haarlight {

PixelRectangle parse_rectangle(const std::string& text, const std::string& option) {
  PixelRectangle r;
  constexpr int kMaxSide = 1 << 17;  // of a picture (core/picture/image_io.cpp)
  char rest = '\0';
  const bool is_read = std::sscanf(text.c_str(), "%6d,%6d,%6d,%6d%c", &r.x, &r.y, &r.width,
                                   &r.height, &rest) == 4;
  if (!is_read || r.x < 0 || r.y < 0 || r.width < 1 || r.height < 1 ||
      std::max({r.x, r.y, r.width, r.height}) > kMaxSide) {
    throw Error("not X,Y,W,H in whole pixels, at least 1 wide and high", option + " " + text,
                fmt::format("for example: {} 120,80,40,30 begins 120 pixels from the left and "
                            "80 from the top, and is 40 wide and 30 high",
                            option),
                ExitCode::usage);
  }
  return r;
}

PixelRectangle stored_rectangle(const PixelRectangle& upright, int width, int height,
                                int orientation, const std::string& option) {
  HAARLIGHT_EXPECTS(orientation >= 1 && orientation <= 8, "EXIF's orientation");
  const bool is_on_side = orientation >= 5;  // 5 to 8: the upright picture's x is the stored y
  const int upright_width = is_on_side ? height : width;
  const int upright_height = is_on_side ? width : height;
  const PixelRectangle& r = upright;
  if (r.width < 1 || r.height < 1 || r.x < 0 || r.y < 0 || r.x > upright_width - r.width ||
      r.y > upright_height - r.height) {
    throw Error(
        fmt::format("{} x {} pixels from ({}, {}) leave the pictures, which are {} x {}{}",
                    r.width, r.height, r.x, r.y, upright_width, upright_height,
                    orientation == 1 ? "" : " seen upright"),
        option, "count from the picture's upper left corner, as it is seen upright",
        ExitCode::usage);
  }
  PixelRectangle s = r;
  if (is_on_side) {
    s = {r.y, r.x, r.height, r.width};
  }
  // EXIF 2.32, 4.6.4.A: where the stored picture's row 0 and column 0 are seen.
  const bool is_mirrored_in_x =
      orientation == 2 || orientation == 3 || orientation == 7 || orientation == 8;
  const bool is_mirrored_in_y =
      orientation == 3 || orientation == 4 || orientation == 6 || orientation == 7;
  if (is_mirrored_in_x) {
    s.x = width - s.x - s.width;
  }
  if (is_mirrored_in_y) {
    s.y = height - s.y - s.height;
  }
  return s;
}

void require_same_orientation(std::span<const std::filesystem::path> pictures,
                              std::span<const int> orientations) {
  for (std::size_t i = 1; i < orientations.size(); ++i) {
    if (orientations[i] != orientations[0]) {
      throw Error(
          fmt::format("is turned otherwise (EXIF orientation {}) than {} ({})", orientations[i],
                      pictures[0].filename().string(), orientations[0]),
          pictures[i].string(),
          "a rectangle needs pictures that lie alike: set one orientation in all");
    }
  }
}

Image<float> cut(const Image<float>& image, const PixelRectangle& rectangle) {
  HAARLIGHT_EXPECTS(rectangle.x >= 0 && rectangle.y >= 0 &&
                        rectangle.x + rectangle.width <= image.width() &&
                        rectangle.y + rectangle.height <= image.height(),
                    "a rectangle of the picture");
  Image<float> out(rectangle.height, rectangle.width, image.channels());
  const std::ptrdiff_t first = std::ptrdiff_t{rectangle.x} * image.channels();
  for (int y = 0; y < rectangle.height; ++y) {
    const auto from = image.view().row(rectangle.y + y);
    const auto to = out.view().row(y);
    std::copy_n(from.begin() + first, to.size(), to.begin());
  }
  return out;
}

}  // namespace haarlight
