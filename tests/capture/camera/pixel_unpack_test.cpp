// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/pixel_unpack.h"

#include <vector>

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "capture/camera/grey_jpeg.h"
#include "core/random.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {
namespace {

/// Where bit b (0 = least) of sample x of a row lies: byte * 8 + bit, bit 0 the least.
/// Written down from linux/videodev2.h's documentation, bit by bit, apart from the code.
std::size_t position_of_bit(PixelPacking packing, std::size_t x, std::size_t b) {
  const std::size_t in4 = x % 4;
  const std::size_t in2 = x % 2;
  switch (packing) {
    case PixelPacking::bytes:
    case PixelPacking::luma_plane:
      return 8 * x + b;
    case PixelPacking::luma_even:
      return 16 * x + b;
    case PixelPacking::luma_odd:
      return 16 * x + 8 + b;
    case PixelPacking::words_le:
      return 16 * x + b;
    case PixelPacking::words_be:
      return b < 8 ? 16 * x + 8 + b : 16 * x + b - 8;
    case PixelPacking::mipi10:  // bits 9..2 one byte each; bits 1..0 of sample i at 2 i of the
                                // fifth
      return 40 * (x / 4) + (b >= 2 ? 8 * in4 + b - 2 : 32 + 2 * in4 + b);
    case PixelPacking::mipi12:  // bits 11..4 one byte each; bits 3..0 share the third
      return 24 * (x / 2) + (b >= 4 ? 8 * in2 + b - 4 : 16 + 4 * in2 + b);
    case PixelPacking::mipi14:  // bits 13..6 one byte each; bits 5..0 one after the other
      return 56 * (x / 4) + (b >= 6 ? 8 * in4 + b - 6 : 32 + 6 * in4 + b);
    case PixelPacking::bits10: {  // bit 9 of sample 0 is the most significant of byte 0
      const std::size_t from_left = 10 * x + 9 - b;
      return from_left / 8 * 8 + 7 - from_left % 8;
    }
    case PixelPacking::ipu3:  // 25 samples from bit 0 of 32 bytes
      return 256 * (x / 25) + 10 * (x % 25) + b;
    case PixelPacking::motion_jpeg:
      break;
  }
  ADD_FAILURE();
  return 0;
}

struct Packing {
  PixelPacking packing;
  unsigned bits;
};
const std::vector<Packing> kPackings{
    {PixelPacking::bytes, 8},    {PixelPacking::words_le, 16},  {PixelPacking::words_be, 16},
    {PixelPacking::mipi10, 10},  {PixelPacking::mipi12, 12},    {PixelPacking::mipi14, 14},
    {PixelPacking::bits10, 10},  {PixelPacking::ipu3, 10},      {PixelPacking::luma_even, 8},
    {PixelPacking::luma_odd, 8}, {PixelPacking::luma_plane, 8},
};

std::uint16_t slow_sample(const Packing& form, const std::byte* row, std::size_t x) {
  unsigned value = 0;
  for (unsigned b = 0; b < form.bits; ++b) {
    const std::size_t position = position_of_bit(form.packing, x, b);
    value |= (std::to_integer<unsigned>(row[position / 8]) >> (position % 8) & 1U) << b;
  }
  return static_cast<std::uint16_t>(value);
}

std::vector<std::byte> noise(std::size_t n, std::uint64_t seed) {
  std::vector<std::byte> bytes(n);
  for (std::size_t i = 0; i < n; ++i) {
    bytes[i] = static_cast<std::byte>(hash_key(seed, i));
  }
  return bytes;
}

// The buffer ends with the last sample's byte: a sanitizer sees any read beyond.
RC_GTEST_PROP(PixelUnpack, EveryPackingAgreesWithTheSlowBitReader, (std::uint64_t seed)) {
  const Packing form = *rc::gen::elementOf(kPackings);
  const int width = *rc::gen::inRange(1, 61);
  const int height = *rc::gen::inRange(1, 4);
  const std::size_t stride =
      packed_row_bytes(form.packing, width) + *rc::gen::inRange<std::size_t>(0, 40);
  const auto bytes = noise(packed_frame_bytes(form.packing, width, height, stride), seed);
  Image<std::uint16_t> words(height, width, 1);
  const std::uint16_t all = unpack_pixels(form.packing, bytes, stride, words.view());
  unsigned expected_all = 0;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const std::byte* row = bytes.data() + stride * static_cast<std::size_t>(y);
      const std::uint16_t expected = slow_sample(form, row, static_cast<std::size_t>(x));
      RC_ASSERT(words(y, x) == expected);
      expected_all |= expected;
    }
  }
  RC_ASSERT((all & expected_all) == expected_all);
  if (form.packing == PixelPacking::words_le || form.packing == PixelPacking::words_be) {
    RC_ASSERT(all == expected_all);
  }
}

/// A row of one set bit gives one set bit of one sample: no bit is lost, doubled or swapped.
TEST(PixelUnpack, EverySingleBitOfAGroupArrivesAtItsPosition) {
  for (const Packing& form : kPackings) {
    constexpr int kWidth = 50;
    std::vector<std::byte> bytes(packed_row_bytes(form.packing, kWidth));
    Image<std::uint16_t> words(1, kWidth, 1);
    for (int x = 0; x < kWidth; ++x) {
      for (unsigned b = 0; b < form.bits; ++b) {
        const std::size_t position =
            position_of_bit(form.packing, static_cast<std::size_t>(x), b);
        std::fill(bytes.begin(), bytes.end(), std::byte{0});
        bytes[position / 8] = static_cast<std::byte>(1U << (position % 8));
        (void)unpack_pixels(form.packing, bytes, bytes.size(), words.view());
        for (int i = 0; i < kWidth; ++i) {
          ASSERT_EQ(words(0, i), i == x ? 1U << b : 0U)
              << "packing " << static_cast<int>(form.packing) << " sample " << x << " bit "
              << b;
        }
      }
    }
  }
}

TEST(PixelUnpack, TheDocumentedExamplesHold) {
  // Samples 0x155, 0x2AA, 0x3FF, 0x001 as MIPI RAW10.
  const std::vector<std::byte> raw10{std::byte{0x55}, std::byte{0xAA}, std::byte{0xFF},
                                     std::byte{0x00}, std::byte{0b01'11'10'01}};
  Image<std::uint16_t> words(1, 4, 1);
  EXPECT_EQ(unpack_pixels(PixelPacking::mipi10, raw10, 5, words.view()), 0x3FF);
  EXPECT_EQ(words(0, 0), 0x155);
  EXPECT_EQ(words(0, 1), 0x2AA);
  EXPECT_EQ(words(0, 2), 0x3FF);
  EXPECT_EQ(words(0, 3), 0x001);
  // Samples 0xABC, 0x123 as MIPI RAW12.
  const std::vector<std::byte> raw12{std::byte{0xAB}, std::byte{0x12}, std::byte{0x3C}};
  Image<std::uint16_t> two(1, 2, 1);
  (void)unpack_pixels(PixelPacking::mipi12, raw12, 3, two.view());
  EXPECT_EQ(two(0, 0), 0xABC);
  EXPECT_EQ(two(0, 1), 0x123);
}

TEST(PixelUnpack, TooFewBytesOrATooSmallStrideAreOurBug) {
  Image<std::uint16_t> words(2, 8, 1);
  const std::vector<std::byte> bytes(40);
  EXPECT_THROW((void)unpack_pixels(PixelPacking::words_le, bytes, 15, words.view()),
               ContractViolation);
  EXPECT_THROW((void)unpack_pixels(PixelPacking::words_le, bytes, 30, words.view()),
               ContractViolation);
}

TEST(PixelUnpack, EveryFormatsBitsFitItsPacking) {
  for (const PixelFormat& format : pixel_formats()) {
    if (format.packing == PixelPacking::motion_jpeg) {
      continue;
    }
    const auto bytes =
        std::vector<std::byte>(packed_row_bytes(format.packing, 25), std::byte{0xFF});
    Image<std::uint16_t> words(1, 25, 1);
    const unsigned all = unpack_pixels(format.packing, bytes, bytes.size(), words.view());
    const unsigned white = (1U << static_cast<unsigned>(format.bits)) - 1U;
    const bool is_container = format.packing == PixelPacking::words_le;
    EXPECT_EQ(all, is_container ? 0xFFFFU : white) << format.fourcc;
  }
}

TEST(PixelFormat, LettersAreFoundOnceAndWithoutTheirBlanks) {
  for (const PixelFormat& format : pixel_formats()) {
    EXPECT_EQ(find_pixel_format(format.fourcc), &format) << format.fourcc;
  }
  EXPECT_EQ(find_pixel_format("Y10"), find_pixel_format("Y10 "));
  EXPECT_NE(find_pixel_format("Y16"), find_pixel_format("Y16 -BE"));
  EXPECT_EQ(find_pixel_format(""), nullptr);
  EXPECT_EQ(find_pixel_format("RGB3"), nullptr);
}

std::span<const std::byte> bytes_of(const std::string& text) {
  return std::as_bytes(std::span<const char>(text));
}

TEST(GreyJpeg, AFlatPictureComesBackAndADamagedOneDoesNot) {
  Image<std::uint8_t> grey(24, 40, 1);
  std::fill(grey.pixels().begin(), grey.pixels().end(), std::uint8_t{77});
  const std::string jpeg = encode_grey_jpeg(std::as_const(grey).view());
  Image<std::uint16_t> words(24, 40, 1);
  ASSERT_TRUE(decode_grey_jpeg(bytes_of(jpeg), words.view()));
  for (const std::uint16_t word : words.pixels()) {
    EXPECT_EQ(word, 77);  // a flat block has one coefficient, and the tables' error rounds away
  }
  Image<std::uint16_t> other(24, 39, 1);
  EXPECT_FALSE(decode_grey_jpeg(bytes_of(jpeg), other.view()));
  EXPECT_FALSE(decode_grey_jpeg(bytes_of(jpeg).subspan(0, jpeg.size() / 2), words.view()));
  EXPECT_FALSE(decode_grey_jpeg(bytes_of("no picture"), words.view()));
  EXPECT_FALSE(decode_grey_jpeg({}, words.view()));
}

}  // namespace
}  // namespace haarlight::capture
