// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/plate/plate_sample.h"

#include <gtest/gtest.h>

#include "relight/basis/plate/plate.h"

namespace haarlight::relight {
namespace {

Rig small_rig() { return read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml"); }

TEST(PlateSample, IsThePlateItselfAtPixelsSpreadEvenly) {
  const Rig rig = small_rig();
  const ComputedPlate plate(rig);
  const StackDims dims = plate.dims();
  constexpr int kPixels = 7;
  const std::vector<float> sample = sample_plate(rig, kPixels);
  ASSERT_EQ(sample.size(), std::size_t{kPixels} * 64);
  const int third = static_cast<int>(3 * dims.n_pixels() / kPixels);
  std::vector<float> row(64);
  plate.read_tile({third % dims.width, third / dims.width, 1, 1}, row);
  EXPECT_TRUE(std::equal(row.begin(), row.end(), sample.begin() + 3 * std::ptrdiff_t{64}));
}

TEST(PlateSample, IsReadByRowsForACameraOfThatSizeOnly) {
  const Rig rig = small_rig();
  const ComputedPlate plate(rig);
  EXPECT_FALSE(computed_pixels(rig, 7, 5).read);
  const session::PlatePixels pixels =
      computed_pixels(rig, plate.dims().width, plate.dims().height);
  ASSERT_TRUE(pixels.read);
  std::vector<float> expected(std::size_t{3} * 64);
  std::vector<float> found(expected.size());
  plate.read_tile({4, 9, 3, 1}, expected);
  pixels.read(9, 4, 7, found);
  EXPECT_EQ(found, expected);
}

}  // namespace
}  // namespace haarlight::relight
