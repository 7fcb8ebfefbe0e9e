// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/picture/picture_rectangle.h"

#include <array>
#include <filesystem>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace haarlight {
namespace {

/// Where EXIF says that the stored picture's row 0 and column 0 are seen.
enum class Side { top, bottom, left, right };
struct Turn {
  Side row;
  Side column;
};
constexpr std::array<Turn, 9> kTurns = {{{},
                                         {Side::top, Side::left},
                                         {Side::top, Side::right},
                                         {Side::bottom, Side::right},
                                         {Side::bottom, Side::left},
                                         {Side::left, Side::top},
                                         {Side::right, Side::top},
                                         {Side::right, Side::bottom},
                                         {Side::left, Side::bottom}}};

constexpr int kUprightWidth = 7;
constexpr int kUprightHeight = 5;

/// Moves the upright position (u, v) by a line that is stored as number `i` from `side`.
void place(Side side, int i, int& u, int& v) {
  switch (side) {
    case Side::top:
      v = i;
      break;
    case Side::bottom:
      v = kUprightHeight - 1 - i;
      break;
    case Side::left:
      u = i;
      break;
    case Side::right:
      u = kUprightWidth - 1 - i;
      break;
  }
}

int number_of(int u, int v) { return 100 * v + u; }

/// A picture whose values name the upright positions, as it is stored.
Image<float> stored_picture(int orientation) {
  const bool is_on_side = orientation >= 5;
  const int width = is_on_side ? kUprightHeight : kUprightWidth;
  const int height = is_on_side ? kUprightWidth : kUprightHeight;
  Image<float> picture(height, width, 1);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      int u = 0;
      int v = 0;
      place(kTurns.at(static_cast<std::size_t>(orientation)).row, y, u, v);
      place(kTurns.at(static_cast<std::size_t>(orientation)).column, x, u, v);
      picture(y, x) = static_cast<float>(number_of(u, v));
    }
  }
  return picture;
}

TEST(PictureRectangle, OfTheUprightPictureIsFoundInTheStoredOne) {
  constexpr PixelRectangle kUpright{1, 2, 4, 2};
  std::set<int> wanted;
  for (int v = 2; v < 4; ++v) {
    for (int u = 1; u < 5; ++u) {
      wanted.insert(number_of(u, v));
    }
  }
  for (int orientation = 1; orientation <= 8; ++orientation) {
    const Image<float> picture = stored_picture(orientation);
    const PixelRectangle stored =
        stored_rectangle(kUpright, picture.width(), picture.height(), orientation, "--crop");
    std::set<int> found;
    const Image<float> part = cut(picture, stored);
    for (const float value : part.pixels()) {
      found.insert(static_cast<int>(value));
    }
    EXPECT_EQ(found, wanted) << orientation;
  }
}

TEST(PictureRectangle, OutsideOfThePictureIsRefusedWithItsUprightSize) {
  for (const PixelRectangle& r : {PixelRectangle{0, 0, 8, 5},
                                  {1, 0, 7, 5},
                                  {0, 0, 7, 6},
                                  {0, 5, 1, 1},
                                  {100000, 0, 1, 1},
                                  {0, 0, 0, 3}}) {
    for (const int orientation : {1, 6}) {
      const bool is_on_side = orientation == 6;
      try {
        (void)stored_rectangle(r, is_on_side ? 5 : 7, is_on_side ? 7 : 5, orientation,
                               "--crop");
        ADD_FAILURE() << "accepted";
      } catch (const Error& error) {
        EXPECT_THAT(error.what(), ::testing::HasSubstr("7 x 5"));
        EXPECT_THAT(error.what(), ::testing::HasSubstr("--crop"));
      }
    }
  }
}

TEST(PictureRectangle, IsReadFromFourWholeNumbers) {
  EXPECT_EQ(parse_rectangle("3,4,50,6", "--crop"), (PixelRectangle{3, 4, 50, 6}));
  for (const char* text :
       {"", "1,2,3", "1,2,3,4,5", "1,2,0,4", "1,2,3,0", "-1,2,3,4", "a,2,3,4", "1,2,3,4x",
        "1.5,2,3,4", "1,2,99999999999,4", "1;2;3;4"}) {
    EXPECT_THROW((void)parse_rectangle(text, "--crop"), Error) << text;
  }
}

TEST(PictureRectangle, NeedsPicturesThatAreTurnedAlike) {
  const std::array<std::filesystem::path, 3> paths = {"a.jpg", "b.jpg", "c.jpg"};
  EXPECT_NO_THROW(require_same_orientation(paths, std::array<int, 3>{6, 6, 6}));
  try {
    require_same_orientation(paths, std::array<int, 3>{1, 1, 6});
    ADD_FAILURE() << "accepted";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), ::testing::HasSubstr("c.jpg"));
  }
}

}  // namespace
}  // namespace haarlight
