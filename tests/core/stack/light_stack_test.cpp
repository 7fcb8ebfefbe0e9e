// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/stack/light_stack.h"

#include <algorithm>
#include <numeric>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "tests/temporary_folder.h"

namespace haarlight {
namespace {

using testing::TemporaryFolder;

constexpr StackDims kShape{.width = 45, .height = 7, .channels = 3, .n_lights = 37};
constexpr int kBandRows = 3;

/// A value of its own for each pixel, channel and light; exact as a float.
float value_at(int y, int x, int c, int k) {
  return static_cast<float>(((y * kShape.width + x) * 3 + c) * kShape.n_lights + k);
}

LightStack make_stack(const std::filesystem::path& file) {
  LightStackWriter writer(file, kShape, kBandRows);
  for (int y0 = 0; y0 < kShape.height; y0 += kBandRows) {
    std::vector<float> band;
    for (int c = 0; c < kShape.channels; ++c) {
      for (int y = y0; y < std::min(y0 + kBandRows, kShape.height); ++y) {
        for (int x = 0; x < kShape.width; ++x) {
          for (int k = 0; k < kShape.n_lights; ++k) {
            band.push_back(value_at(y, x, c, k));
          }
        }
      }
    }
    writer.append_band(band);
  }
  writer.finish();
  return LightStack::open(file);
}

/// Pixels of `picture` that are not those of light k.
int n_wrong(const Image<float>& picture, int k) {
  int n = picture.height() == kShape.height && picture.width() == kShape.width ? 0 : 1;
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      for (int c = 0; c < picture.channels(); ++c) {
        n += picture(y, x, c) == value_at(y, x, c, k) ? 0 : 1;
      }
    }
  }
  return n;
}

TEST(LightStack, GathersThePicturesOfSomeLights) {
  const TemporaryFolder folder;
  const LightStack stack = make_stack(folder / "a.hls");
  EXPECT_EQ(n_wrong(stack.light_images(36, 1).front(), 36), 0);
  const std::vector<Image<float>> pictures = stack.light_images(5, 19);
  ASSERT_EQ(pictures.size(), 19U);
  for (int k = 5; k < 24; ++k) {
    EXPECT_EQ(n_wrong(pictures[static_cast<std::size_t>(k - 5)], k), 0) << k;
  }
  EXPECT_THROW((void)stack.light_images(30, 8), ContractViolation);
  EXPECT_THROW((void)stack.light_images(-1, 2), ContractViolation);
  EXPECT_THROW((void)stack.light_images(3, 0), ContractViolation);
}

TEST(LightStack, VisitsEveryLightInOrderWhateverTheMemory) {
  const TemporaryFolder folder;
  const LightStack stack = make_stack(folder / "a.hls");
  constexpr std::uint64_t kPicture = sizeof(float) * 45 * 7 * 3;
  std::vector<int> all(kShape.n_lights);
  std::iota(all.begin(), all.end(), 0);
  for (const std::uint64_t memory : {std::uint64_t{0}, 10 * kPicture, 1000 * kPicture}) {
    std::vector<int> visited;
    for_each_light_image(stack, memory, [&](int k, const Image<float>& picture) {
      visited.push_back(k);
      EXPECT_EQ(n_wrong(picture, k), 0) << k;
    });
    EXPECT_EQ(visited, all) << memory;
  }
}

}  // namespace
}  // namespace haarlight
