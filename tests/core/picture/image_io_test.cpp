// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/picture/image_io.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "core/picture/srgb_codes.h"
#include "core/random.h"
#include "core/report.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "tests/temporary_folder.h"

namespace haarlight {
namespace {

using ::testing::HasSubstr;
using testing::TemporaryFolder;

Image<float> noise_image(int height, int width, int channels, float scale) {
  Image<float> image(height, width, channels);
  for (std::size_t i = 0; i < image.pixels().size(); ++i) {
    image.pixels()[i] = scale * static_cast<float>(uniform_unit(hash_key(1, i)));
  }
  return image;
}

std::string message_of(const std::filesystem::path& path) {
  try {
    (void)read_linear_image(path);
  } catch (const Error& error) {
    return error.what();
  }
  return "nothing was thrown";
}

TEST(WriteImage, ExrAndTiffKeepEveryBit) {
  const TemporaryFolder folder;
  const Image<float> image = noise_image(7, 5, 3, 1e6F);
  for (const std::string name : {"a.exr", "a.tif"}) {
    write_image(folder / name, image.view());
    const Image<float> back = read_linear_image(folder / name);
    ASSERT_EQ(back.channels(), 3);
    for (std::size_t i = 0; i < image.pixels().size(); ++i) {
      EXPECT_EQ(back.pixels()[i], image.pixels()[i]);
    }
  }
}

TEST(WriteImage, PngIsWithinHalfACodeAfterTheTransfer) {
  const TemporaryFolder folder;
  const Image<float> image = noise_image(9, 4, 1, 1.0F);
  write_image(folder / "a.png", image.view());
  const PictureFile back = read_picture(folder / "a.png");
  EXPECT_EQ(back.bits_per_sample, 8);
  EXPECT_EQ(back.transfer, Transfer::srgb);
  for (std::size_t i = 0; i < image.pixels().size(); ++i) {
    // half a code of 255, and 1e-3 of a code for float rounding
    EXPECT_NEAR(back.pixels.pixels()[i], srgb_from_linear(image.pixels()[i]), 0.501 / 255.0);
  }
}

/// Read by the formats' own rules: PNG's tEXt chunks and OpenEXR's string attributes.
TEST(WriteImage, PngAndExrCarryTheirNotesAndTheSamePictureGivesTheSameBytes) {
  const TemporaryFolder folder;
  const Image<float> image = noise_image(4, 5, 3, 1.0F);
  const std::string long_text(20000, 'w');
  const std::vector<PictureNote> notes = {{"haarlightRoot", "0123abcd"},
                                          {"haarlightWeights", long_text}};
  const auto big_endian = [](std::size_t n) {
    std::string bytes;
    for (unsigned shift : {24U, 16U, 8U, 0U}) {
      bytes += static_cast<char>(n >> shift & 255U);
    }
    return bytes;
  };
  const auto little_endian = [&](std::size_t n) {
    const std::string bytes = big_endian(n);
    return std::string(bytes.rbegin(), bytes.rend());
  };
  for (const std::string name : {"a.png", "a.exr"}) {
    write_image(folder / name, image.view(), 2.5, {.texts = notes, .facts = {}});
    const std::string bytes = read_file(folder / name);
    const bool is_png = name == "a.png";
    for (const PictureNote& note :
         {notes[0], notes[1], PictureNote{"haarlightProgram", "haarlight " HAARLIGHT_VERSION},
          PictureNote{"haarlightExposure", is_png ? "2.5" : "1"}}) {
      const std::string zero(1, '\0');
      std::string expected = note.name + zero;
      if (is_png) {
        expected.insert(0, big_endian(note.name.size() + 1 + note.text.size()) + "tEXt");
      } else {
        expected += "string" + zero + little_endian(note.text.size());
      }
      expected += note.text;
      EXPECT_NE(bytes.find(expected), std::string::npos) << name << ": " << note.name;
    }
    write_image(folder / name, image.view(), 2.5, {.texts = notes, .facts = {}});
    EXPECT_TRUE(read_file(folder / name) == bytes) << name;
  }
}

TEST(WriteImage, RefusesAnUnknownEnding) {
  EXPECT_THROW(write_image("a.bmp", noise_image(1, 1, 1, 1.0F).view()), Error);
}

TEST(ReadPicture, NamesFilesThatAreNoPictures) {
  const TemporaryFolder folder;
  write_file_atomically(folder / "text.png", "this is not a picture at all, though it is long");
  write_file_atomically(folder / "empty.exr", "");
  EXPECT_THAT(message_of(folder / "text.png"), HasSubstr("text.png: not a picture"));
  EXPECT_THAT(message_of(folder / "empty.exr"), HasSubstr("not a picture"));
  EXPECT_THAT(message_of(folder / "none.exr"), HasSubstr("cannot open"));
}

TEST(ReadPicture, RefusesTruncatedFiles) {
  const TemporaryFolder folder;
  const Image<float> image = noise_image(64, 64, 3, 1.0F);
  for (const std::string name : {"a.exr", "a.png", "a.tif"}) {
    write_image(folder / name, image.view());
    const std::string bytes = read_file(folder / name);
    for (const double fraction : {0.1, 0.5, 0.9}) {
      const auto n = static_cast<std::size_t>(fraction * static_cast<double>(bytes.size()));
      write_file_atomically(folder / name, std::string_view(bytes).substr(0, n));
      EXPECT_THROW((void)read_picture(folder / name), Error) << name << " cut at " << fraction;
    }
  }
}

/// Every seed of the fuzzer whose header claims a picture that its bytes cannot hold.
TEST(ReadPicture, RefusesClaimsThatTheBytesCannotHold) {
  int n_claims = 0;
  for (const auto& entry :
       std::filesystem::directory_iterator(HAARLIGHT_SOURCE_DIR "/tests/core/corpus/picture")) {
    const std::string name = entry.path().stem().string();
    if (!name.starts_with("claims") && name != "window") {
      continue;
    }
    ++n_claims;
    EXPECT_THAT(
        message_of(entry.path()),
        ::testing::AnyOf(HasSubstr("bytes cannot hold"), HasSubstr("2^28 pixels"),
                         HasSubstr("cannot be decoded"), HasSubstr("ends before its header")))
        << entry.path();
  }
  EXPECT_GE(n_claims, 10);
  EXPECT_LT(peak_memory_bytes(), std::size_t{512} << 20U);
}

TEST(ReadPicture, HoldsTheMemoryLimit) {
  const TemporaryFolder folder;
  write_image(folder / "a.tif", noise_image(256, 256, 3, 1.0F).view());
  limit_picture_memory(std::uint64_t{1} << 20U);
  EXPECT_THAT(message_of(folder / "a.tif"),
              HasSubstr("give a smaller picture, or more by --memory"));
  limit_picture_memory(std::uint64_t{4} << 30U);
  EXPECT_NO_THROW((void)read_picture(folder / "a.tif"));
}

/// A picture of one grey is the smallest that a good file can be.
TEST(ReadPicture, TakesGreyPicturesHoweverSmallTheirFiles) {
  const TemporaryFolder folder;
  Image<float> grey(1024, 2048, 3);
  std::fill(grey.pixels().begin(), grey.pixels().end(), 0.5F);
  for (const std::string name : {"a.exr", "a.png", "a.tif"}) {
    write_image(folder / name, grey.view());
    EXPECT_NO_THROW((void)read_picture(folder / name)) << name;
  }
}

TEST(ReadPicture, RefusesACutJpegThatLibjpegWouldFillWithGrey) {
  const std::filesystem::path original =
      HAARLIGHT_SOURCE_DIR "/../shared/data/rti_real/item1/image00.jpg";
  if (!std::filesystem::exists(original)) {
    GTEST_SKIP() << "no shared data here";
  }
  EXPECT_NO_THROW((void)read_picture(original));
  const TemporaryFolder folder;
  const std::string bytes = read_file(original);
  for (const std::size_t missing : {std::size_t{1}, std::size_t{2}, bytes.size() / 2}) {
    write_file_atomically(folder / "a.jpg",
                          std::string_view(bytes).substr(0, bytes.size() - missing));
    EXPECT_THAT(message_of(folder / "a.jpg"), HasSubstr("ends before the picture does"));
  }
}

TEST(ReadLinearImage, NamesThePixelThatIsNotANumber) {
  const TemporaryFolder folder;
  Image<float> image = noise_image(4, 6, 3, 1.0F);
  image(2, 5, 1) = std::numeric_limits<float>::quiet_NaN();
  write_image(folder / "a.exr", image.view());
  EXPECT_THAT(message_of(folder / "a.exr"),
              HasSubstr("a.exr: pixel (x 5, y 2) is not a finite"));
}

TEST(SrgbTransfer, HasTheStandardsFixedPoints) {
  EXPECT_FLOAT_EQ(srgb_from_linear(0.0F), 0.0F);
  EXPECT_FLOAT_EQ(srgb_from_linear(1.0F), 1.0F);
  EXPECT_NEAR(linear_from_srgb(0.5F), 0.21404114F, 1e-7F);  // ((0.5 + 0.055)/1.055)^2.4
}

RC_GTEST_PROP(SrgbTransfer, RoundTrips, ()) {
  const float linear = static_cast<float>(*rc::gen::inRange(-1'000'000, 1'000'000)) / 1e6F;
  RC_ASSERT(std::abs(linear_from_srgb(srgb_from_linear(linear)) - linear) < 1e-6F);
}

TEST(SrgbCodes, AreThoseOfTheCurve) {
  const SrgbCodes& table = SrgbCodes::table();
  const auto computed = [](float linear) {
    const float code = 255.0F * srgb_from_linear(linear);
    return code > 0.0F ? std::lround(std::min(code, 255.0F)) : 0L;
  };
  // A prime step through all floats from below the first code to beyond the last.
  const auto end = std::bit_cast<std::uint32_t>(1.5F);
  for (auto bits = std::bit_cast<std::uint32_t>(1e-5F); bits < end; bits += 997) {
    const auto linear = std::bit_cast<float>(bits);
    ASSERT_EQ(table.code(linear), computed(linear)) << linear;
  }
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  EXPECT_EQ(table.code(std::numeric_limits<float>::quiet_NaN()), 0);
  EXPECT_EQ(table.code(-kInfinity), 0);
  EXPECT_EQ(table.code(-0.5F), 0);
  EXPECT_EQ(table.code(1.0F), 255);
  EXPECT_EQ(table.code(kInfinity), 255);
}

}  // namespace
}  // namespace haarlight
