// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/picture_files.h"

#include <cmath>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "tests/core/picture/picture_files.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

using testing::TemporaryFolder;
using testing::write_jpeg;
using testing::write_png;
using testing::write_tiff;

constexpr int kWidth = 24;
constexpr int kHeight = 40;

std::vector<std::uint8_t> samples_of(int phase) {
  std::vector<std::uint8_t> samples;
  for (int i = 0; i < kWidth * kHeight * 3; ++i) {
    samples.push_back(
        static_cast<std::uint8_t>(std::lround(128.0 + 100.0 * std::sin(0.02 * i + phase))));
  }
  return samples;
}

const testing::PngForm kPng{.width = kWidth, .height = kHeight};

std::vector<std::uint16_t> read_all(PictureRows& rows) {
  const StackDims shape = rows.dims();
  const int n = shape.width * shape.height * shape.n_lights * 3;
  std::vector<std::uint16_t> all(static_cast<std::size_t>(n));
  const std::span<std::uint16_t> out(all);
  rows.rewind();
  constexpr std::size_t kFirst = 17;
  const std::size_t n_row = all.size() / static_cast<std::size_t>(shape.height);
  rows.read(kFirst, out.first(kFirst * n_row));
  rows.read(shape.height - static_cast<int>(kFirst), out.subspan(kFirst * n_row));
  return all;
}

/// Codes of light `k` of `n` at a row.
std::span<const std::uint16_t> row_of(const std::vector<std::uint16_t>& all, int y, int k,
                                      int n) {
  constexpr std::size_t kRow = std::size_t{kWidth} * 3;
  return std::span(all).subspan(static_cast<std::size_t>(y * n + k) * kRow, kRow);
}

TEST(PictureFiles, PngAndTiffGiveTheirBytes) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> a = samples_of(0);
  const std::vector<std::uint8_t> b = samples_of(1);
  write_png(folder / "a.png", kPng, a);
  write_tiff(folder / "b.tif",
             {.width = kWidth, .height = kHeight, .samples = 3, .photometric = PHOTOMETRIC_RGB},
             b);
  for (const std::uint64_t memory : {std::uint64_t{1} << 29U, std::uint64_t{0}}) {
    const PictureFiles files =
        picture_rows({folder / "a.png", folder / "b.tif"},
                     {.memory_bytes = memory, .work_folder = folder.path()});
    EXPECT_EQ(files.profile, "");
    const std::vector<std::uint16_t> all = read_all(*files.rows);
    for (int y = 0; y < kHeight; ++y) {
      for (std::size_t i = 0; i < std::size_t{kWidth} * 3; ++i) {
        const std::size_t at = static_cast<std::size_t>(y) * kWidth * 3 + i;
        ASSERT_EQ(row_of(all, y, 0, 2)[i], a[at] * 257);
        ASSERT_EQ(row_of(all, y, 1, 2)[i], b[at] * 257);
      }
    }
    EXPECT_EQ(read_all(*files.rows), all);  // again from the first row
  }
}

TEST(PictureFiles, JpegsAreReadAlikeByLinesAndWhole) {
  const TemporaryFolder folder;
  write_jpeg(folder / "a.jpg", {.width = kWidth, .height = kHeight}, samples_of(0));
  write_jpeg(folder / "b.jpg", {.width = kWidth, .height = kHeight}, samples_of(1));
  write_jpeg(folder / "c.jpg", {.width = kWidth, .height = kHeight, .is_progressive = true},
             samples_of(1));
  const PictureFiles by_lines = picture_rows({folder / "a.jpg", folder / "b.jpg"});
  const PictureFiles whole = picture_rows({folder / "a.jpg", folder / "c.jpg"});
  EXPECT_TRUE(is_line_jpeg(folder / "b.jpg"));
  EXPECT_FALSE(is_line_jpeg(folder / "c.jpg"));
  EXPECT_EQ(read_all(*by_lines.rows), read_all(*whole.rows));
}

/// As `import` has it: the profile's light of Rec. 709, here coded as sRGB again.
TEST(PictureFiles, ProfilesAreApplied) {
  const TemporaryFolder folder;
  testing::PngForm form = kPng;
  form.gamma = 1.0 / 1.8;
  form.primaries = {0.3127, 0.3290, 0.68, 0.32, 0.265, 0.69, 0.15, 0.06};  // Display P3
  write_png(folder / "a.png", form, samples_of(0));
  write_png(folder / "b.png", kPng, samples_of(0));  // without one
  const PictureFiles files = picture_rows({folder / "a.png", folder / "b.png"});
  EXPECT_NE(files.profile, "");
  const std::vector<std::uint16_t> all = read_all(*files.rows);
  const Image<float> a = read_linear_image(folder / "a.png");
  const std::vector<std::uint8_t> b = samples_of(0);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      for (int c = 0; c < 3; ++c) {
        const int column = 3 * x + c;
        const auto i = static_cast<std::size_t>(column);
        const float code = srgb_from_linear(std::clamp(a(y, x, c), 0.0F, 1.0F));
        ASSERT_NEAR(row_of(all, y, 0, 2)[i], 65535.0F * code, 0.51F);
        ASSERT_EQ(row_of(all, y, 1, 2)[i],
                  b[static_cast<std::size_t>(y * kWidth) * 3 + i] * 257);
      }
    }
  }
}

TEST(PictureFiles, WhatCannotBeFittedIsNamed) {
  const TemporaryFolder folder;
  write_png(folder / "a.png", kPng, samples_of(0));
  testing::PngForm small = kPng;
  small.height = 20;
  write_png(folder / "small.png", small, samples_of(0));
  const Image<float> light(kHeight, kWidth, 3);
  write_image(folder / "light.exr", light.view());
  const auto refusal = [&](const char* name) -> std::string {
    try {
      (void)picture_rows({folder / "a.png", folder / name});
    } catch (const Error& error) {
      return error.what();
    }
    return "taken";
  };
  EXPECT_NE(refusal("small.png").find("24 x 20; a.png is 24 x 40"), std::string::npos)
      << refusal("small.png");
  EXPECT_NE(refusal("light.exr").find("haarlight import"), std::string::npos)
      << refusal("light.exr");
}

}  // namespace
}  // namespace haarlight::relight
