// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/film/film_settings.h"

#include <gtest/gtest.h>

namespace haarlight::render {
namespace {

TEST(Crop, IsReadAsItIsWritten) {
  const Crop crop{.width = 640, .height = 480, .x = 100, .y = 0};
  EXPECT_EQ(crop_text(crop), "640x480+100+0");
  EXPECT_EQ(parse_crop("640x480+100+0"), crop);
  for (const char* wrong :
       {"", "640x480", "640x480+1", "0x4+0+0", "4x0+0+0", "4x4-1+0", "4x4+1+1 ", " 4x4+1+1",
        "4X4+1+1", "99999999999x1+0+0", "4x4+0x1+1", "4x4++1+1"}) {
    EXPECT_EQ(parse_crop(wrong), std::nullopt) << wrong;
  }
}

TEST(Crop, IsWithinAPictureUpToItsLastPixel) {
  EXPECT_TRUE(is_within({.width = 10, .height = 8, .x = 90, .y = 42}, 100, 50));
  EXPECT_FALSE(is_within({.width = 10, .height = 8, .x = 91, .y = 42}, 100, 50));
  EXPECT_FALSE(is_within({.width = 10, .height = 8, .x = 90, .y = 43}, 100, 50));
  // Where a sum would be more than an int holds.
  EXPECT_FALSE(is_within({.width = 2147483647, .height = 1, .x = 2147483647, .y = 0}, 100, 50));
}

}  // namespace
}  // namespace haarlight::render
