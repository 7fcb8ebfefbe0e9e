// SPDX-License-Identifier: Apache-2.0
#include "core/picture/picture_formats.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <limits>

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfOutputFile.h>
#include <ImfTiledOutputFile.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/picture_depth.h"
#include "tests/core/picture/picture_files.h"
#include "tests/temporary_folder.h"

namespace haarlight {
namespace {

using ::testing::HasSubstr;
using testing::message_of;
using testing::PngForm;
using testing::TemporaryFolder;
using testing::TiffForm;
using testing::write_jpeg;
using testing::write_png;
using testing::write_tiff;
using namespace std::string_literals;

std::vector<std::uint8_t> noise(std::size_t n) {
  std::vector<std::uint8_t> bytes(n);
  for (std::size_t i = 0; i < n; ++i) {
    bytes[i] = static_cast<std::uint8_t>(hash_key(7, i));
  }
  return bytes;
}

/// Every sample is its integer over `white`, exactly as a float's product can be: 1 ulp.
void expect_units(const PictureFile& picture, std::span<const double> expected) {
  ASSERT_EQ(picture.pixels.pixels().size(), expected.size());
  for (std::size_t i = 0; i < expected.size(); ++i) {
    ASSERT_FLOAT_EQ(picture.pixels.pixels()[i], static_cast<float>(expected[i])) << i;
  }
}

TEST(ReadPng, KnowsEveryDepthPaletteAlphaAndInterlace) {
  const TemporaryFolder folder;
  constexpr std::uint32_t kWidth = 13;
  constexpr std::uint32_t kHeight = 9;
  for (const int interlace : {PNG_INTERLACE_NONE, PNG_INTERLACE_ADAM7}) {
    for (const int bits : {1, 2, 4, 8, 16}) {
      const std::size_t row_bytes = (kWidth * static_cast<std::size_t>(bits) + 7) / 8;
      const std::vector<std::uint8_t> rows = noise(row_bytes * kHeight);
      std::vector<double> expected;
      std::vector<unsigned> samples;
      for (std::size_t y = 0; y < kHeight; ++y) {
        for (std::size_t x = 0; x < kWidth; ++x) {
          unsigned value = 0;
          for (std::size_t bit = x * static_cast<std::size_t>(bits);
               bit < (x + 1) * static_cast<std::size_t>(bits); ++bit) {
            value = 2 * value + (rows[y * row_bytes + bit / 8] >> (7 - bit % 8) & 1U);
          }
          samples.push_back(value);
          expected.push_back(value /
                             static_cast<double>((1U << static_cast<unsigned>(bits)) - 1));
        }
      }
      const PngForm grey{kWidth, kHeight, bits, PNG_COLOR_TYPE_GRAY, interlace};
      write_png(folder / "a.png", grey, rows);
      const PictureFile picture = read_picture(folder / "a.png");
      EXPECT_EQ(picture.bits_per_sample, bits == 16 ? 16 : 8);
      EXPECT_EQ(picture.transfer, Transfer::srgb);
      expect_units(picture, expected);
      if (bits > 8) {
        continue;
      }
      PngForm palette{kWidth, kHeight, bits, PNG_COLOR_TYPE_PALETTE, interlace};
      std::vector<double> colours;
      for (int i = 0; i < 1 << bits; ++i) {
        palette.palette.push_back(
            {static_cast<png_byte>(i), static_cast<png_byte>(255 - i), 7});
      }
      for (const unsigned value : samples) {
        colours.insert(colours.end(), {value / 255.0, (255.0 - value) / 255.0, 7.0 / 255.0});
      }
      write_png(folder / "a.png", palette, rows);
      expect_units(read_picture(folder / "a.png"), colours);
    }
  }
}

TEST(ReadPng, DropsAlphaAndLeavesTheColoursAsStored) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> rows = noise(std::size_t{5} * 4 * 4);
  write_png(folder / "a.png", {5, 4, 8, PNG_COLOR_TYPE_RGB_ALPHA}, rows);
  std::vector<double> expected;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (i % 4 != 3) {
      expected.push_back(rows[i] / 255.0);
    }
  }
  expect_units(read_picture(folder / "a.png"), expected);
}

/// One picture in every way that libtiff stores it.
TEST(ReadTiff, KnowsStripsTilesPlanesCodesAndSampleForms) {
  const TemporaryFolder folder;
  constexpr int kWidth = 32;
  constexpr int kHeight = 16;
  struct Sample {
    int bits;
    int format;
  };
  int n_read = 0;
  for (const Sample sample : {Sample{8, SAMPLEFORMAT_UINT}, Sample{16, SAMPLEFORMAT_UINT},
                              Sample{32, SAMPLEFORMAT_UINT}, Sample{16, SAMPLEFORMAT_IEEEFP},
                              Sample{32, SAMPLEFORMAT_IEEEFP}}) {
    for (const int samples : {1, 3, 4}) {
      const auto n = std::size_t{kWidth} * kHeight * static_cast<std::size_t>(samples);
      const std::size_t bytes_each = static_cast<std::size_t>(sample.bits) / 8;
      std::vector<std::uint8_t> whole(n * bytes_each);
      std::vector<std::uint8_t> planes(whole.size());
      std::vector<double> expected;
      for (std::size_t i = 0; i < n; ++i) {
        const auto value = static_cast<std::uint32_t>(hash_key(3, i));
        const auto low = static_cast<std::uint16_t>(value);
        // halves of exponent 0: 2^0 * (1 + m / 1024)
        const auto half = static_cast<std::uint16_t>(0x3c00U | (value & 0x3ffU));
        const auto real = static_cast<float>(low) - 1000.0F;
        std::array<std::uint8_t, 4> raw{};
        double expect = 0.0;
        if (sample.format == SAMPLEFORMAT_IEEEFP && sample.bits == 32) {
          std::memcpy(raw.data(), &real, 4);
          expect = real;
        } else if (sample.format == SAMPLEFORMAT_IEEEFP) {
          std::memcpy(raw.data(), &half, 2);
          expect = 1.0 + (value & 0x3ffU) / 1024.0;
        } else {
          std::memcpy(raw.data(), &value, 4);  // little-endian: the low bytes
          const double white = std::exp2(sample.bits) - 1.0;
          expect = std::fmod(value, white + 1.0) / white;
        }
        std::copy_n(raw.begin(), bytes_each,
                    whole.begin() + static_cast<std::ptrdiff_t>(i * bytes_each));
        const std::size_t in_planes = i % static_cast<std::size_t>(samples) * kWidth * kHeight +
                                      i / static_cast<std::size_t>(samples);
        std::copy_n(raw.begin(), bytes_each,
                    planes.begin() + static_cast<std::ptrdiff_t>(in_planes * bytes_each));
        if (samples == 1 || i % static_cast<std::size_t>(samples) < 3) {
          expected.push_back(expect);
        }
      }
      for (const int compression : {COMPRESSION_NONE, COMPRESSION_LZW,
                                    COMPRESSION_ADOBE_DEFLATE, COMPRESSION_PACKBITS}) {
        for (const bool is_separate : {false, true}) {
          for (const bool is_tiled : {false, true}) {
            const TiffForm form{
                .width = kWidth,
                .height = kHeight,
                .samples = samples,
                .bits = sample.bits,
                .format = sample.format,
                .photometric = samples == 1 ? PHOTOMETRIC_MINISBLACK : PHOTOMETRIC_RGB,
                .compression = compression,
                .is_separate = is_separate,
                .is_tiled = is_tiled};
            write_tiff(folder / "a.tif", form, is_separate ? planes : whole);
            const PictureFile picture = read_picture(folder / "a.tif");
            EXPECT_EQ(picture.is_floating, sample.format == SAMPLEFORMAT_IEEEFP);
            EXPECT_EQ(picture.bits_per_sample, sample.bits);
            expect_units(picture, expected);
            ++n_read;
          }
        }
      }
    }
  }
  EXPECT_EQ(n_read, 5 * 3 * 4 * 2 * 2);
}

TEST(ReadTiff, KnowsPalettesAndWhiteAsZero) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> rows{0x0f, 0xa5};
  TiffForm form{.width = 4, .height = 1, .bits = 4, .photometric = PHOTOMETRIC_MINISWHITE};
  write_tiff(folder / "a.tif", form, rows);
  expect_units(read_picture(folder / "a.tif"),
               std::vector<double>{1.0, 0.0, 5.0 / 15.0, 10.0 / 15.0});
  form.photometric = PHOTOMETRIC_PALETTE;
  for (int i = 0; i < 48; ++i) {
    form.map.push_back(static_cast<std::uint16_t>(257 * i));
  }
  write_tiff(folder / "a.tif", form, rows);
  std::vector<double> expected;
  for (const int index : {0, 15, 10, 5}) {
    expected.insert(expected.end(),
                    {index / 255.0, (16 + index) / 255.0, (32 + index) / 255.0});
  }
  expect_units(read_picture(folder / "a.tif"), expected);
}

TEST(ReadPicture, RefusesPrintersColoursAndSaysSo) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> samples = noise(std::size_t{16} * 16 * 4);
  write_jpeg(folder / "a.jpg", {.width = 16, .height = 16, .channels = 4}, samples);
  EXPECT_THAT(message_of(folder / "a.jpg"), HasSubstr("CMYK"));
  write_tiff(folder / "a.tif",
             {.width = 16, .height = 16, .samples = 4, .photometric = PHOTOMETRIC_SEPARATED},
             samples);
  EXPECT_THAT(message_of(folder / "a.tif"), HasSubstr("CMYK"));
}

TEST(ReadJpeg, GivesTheSamplesOfGreyAndProgressiveFiles) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> grey(std::size_t{24} * 16, 100);
  for (const bool is_progressive : {false, true}) {
    write_jpeg(folder / "a.jpg",
               {.width = 24, .height = 16, .channels = 1, .is_progressive = is_progressive},
               grey);
    const PictureFile picture = read_picture(folder / "a.jpg");
    EXPECT_EQ(picture.bits_per_sample, 8);
    expect_units(picture, std::vector<double>(grey.size(), 100.0 / 255.0));
  }
}

/// Scans cost time for every pixel and next to no bytes. Those repeated here give all bits of
/// the DC coefficients at once, so that none contradicts the one before.
TEST(ReadJpeg, RefusesAThousandScans) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> grey(std::size_t{64} * 64, 100);
  write_jpeg(folder / "a.jpg",
             {.width = 64, .height = 64, .channels = 1, .is_progressive = true}, grey);
  const std::string bytes = read_file(folder / "a.jpg");
  const std::size_t first = bytes.find("\xff\xda"s);
  ASSERT_NE(first, std::string::npos);
  const std::size_t end =
      std::min(bytes.find("\xff\xda"s, first + 2), bytes.find("\xff\xc4"s, first + 2));
  ASSERT_NE(end, std::string::npos);
  std::string scan = bytes.substr(first, end - first);
  constexpr std::size_t kBitPosition = 9;  // successive approximation, of one component
  scan[kBitPosition] = '\0';
  const auto repeated = [&](int n) {
    std::string many = bytes.substr(0, first);
    for (int i = 0; i < n; ++i) {
      many += scan;
    }
    return many + "\xff\xd9"s;
  };
  write_file_atomically(folder / "ten.jpg", repeated(10));
  EXPECT_EQ(read_picture(folder / "ten.jpg").pixels.width(), 64);
  write_file_atomically(folder / "thousand.jpg", repeated(1000));
  EXPECT_THAT(message_of(folder / "thousand.jpg"), HasSubstr("more than 100 scans"));
}

std::string hdr_text(const std::string& size, const std::string& pixels) {
  return "#?RADIANCE\n# a comment\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=1\n\n" + size + "\n" +
         pixels;
}

TEST(ReadHdr, KnowsBothRunLengthCodes) {
  const TemporaryFolder folder;
  // 2^(129 - 136) * mantissa: 128 is 1.
  const std::string one("\x80\x40\x20\x81", 4);
  const std::string run("\x01\x01\x01\x09", 4);
  const std::string longer("\x01\x01\x01\x01", 4);  // directly behind a run: times 256
  write_file_atomically(folder / "old.hdr",
                        hdr_text("-Y 2 +X 266", one + run + longer + one + run + longer));
  const PictureFile old = read_picture(folder / "old.hdr");
  ASSERT_EQ(old.pixels.width(), 266);
  for (int x = 0; x < 266; ++x) {
    EXPECT_EQ(old.pixels(1, x, 0), 1.0F);
    EXPECT_EQ(old.pixels(1, x, 1), 0.5F);
    EXPECT_EQ(old.pixels(0, x, 2), 0.25F);
  }
  // A run of 8 for red, three times literals.
  const std::string row = "\x02\x02\x00\x08\x88\x80"s +
                          "\x08\x40\x40\x40\x40\x40\x40\x40\x00"s + "\x88\x20"s + "\x88\x81"s;
  write_file_atomically(folder / "new.hdr", hdr_text("-Y 1 +X 8", row));
  const PictureFile picture = read_picture(folder / "new.hdr");
  EXPECT_EQ(picture.pixels(0, 7, 0), 1.0F);
  EXPECT_EQ(picture.pixels(0, 6, 1), 0.5F);
  EXPECT_EQ(picture.pixels(0, 7, 1), 0.0F);
  EXPECT_EQ(picture.facts.orientation, 1);
  write_file_atomically(folder / "turned.hdr", hdr_text("+X 1 -Y 1", one));
  EXPECT_NE(read_picture_facts(folder / "turned.hdr").orientation, 1);
}

TEST(ReadHdr, NamesWhatIsWrong) {
  const TemporaryFolder folder;
  const std::string one("\x80\x40\x20\x81", 4);
  for (const auto& [text, problem] : std::vector<std::pair<std::string, std::string>>{
           {hdr_text("-Y 1 +X 4", one), "ends before"},
           {hdr_text("-Y 1 +X 2", one + "\x01\x01\x01\x09"s), "leaves its row"},
           {hdr_text("-Y 1 +X 2", "\x01\x01\x01\x01"s + one), "leaves its row"},
           {hdr_text("-Y 1 +X 8", "\x02\x02\x00\x08\x90\x80"s), "longer than its row"},
           {hdr_text("-Y 1 +X 8", "\x02\x02\x00\x09\x90\x80"s), "another width"},
           {hdr_text("1 x 1", one), "its size reads"},
           {"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n" + one, "32-bit_rle_xyze"}}) {
    write_file_atomically(folder / "a.hdr", text);
    EXPECT_THAT(message_of(folder / "a.hdr"), HasSubstr(problem));
  }
}

std::string tga_head(int type, int width, int height, int bits, int flags, int map_length = 0) {
  const auto byte = [](int value) { return static_cast<char>(value); };
  std::string head(18, '\0');
  head[1] = byte(map_length > 0 ? 1 : 0);
  head[2] = byte(type);
  head[5] = byte(map_length);
  head[7] = byte(map_length > 0 ? 24 : 0);
  head[12] = byte(width);
  head[14] = byte(height);
  head[16] = byte(bits);
  head[17] = byte(flags);
  return head;
}

TEST(ReadTga, KnowsRunsPalettesFiveBitsAndTheFourCorners) {
  const TemporaryFolder folder;
  const auto read = [&](const std::string& bytes) {
    write_file_atomically(folder / "a.tga", bytes);
    return read_picture(folder / "a.tga");
  };
  // Two pixels per row, blue first: (1, 2, 3), (4, 5, 6); a second row of nines.
  const std::string pixels = "\x03\x02\x01\x06\x05\x04"s + std::string(6, '\x09');
  for (const int flags : {0, 0x10, 0x20, 0x30}) {
    const PictureFile picture = read(tga_head(2, 2, 2, 24, flags) + pixels);
    const int y = (flags & 0x20) != 0 ? 0 : 1;
    const int x = (flags & 0x10) != 0 ? 1 : 0;
    EXPECT_FLOAT_EQ(picture.pixels(y, x, 0), 1.0F / 255.0F) << flags;
    EXPECT_FLOAT_EQ(picture.pixels(y, 1 - x, 2), 6.0F / 255.0F) << flags;
    EXPECT_FLOAT_EQ(picture.pixels(1 - y, x, 1), 9.0F / 255.0F) << flags;
  }
  // A run of three grey pixels that leaves its row, then one of its own.
  expect_units(read(tga_head(11, 2, 2, 8, 0x20) + "\x82\x10\x00\x20"s),
               std::vector<double>{16.0 / 255, 16.0 / 255, 16.0 / 255, 32.0 / 255});
  // Red of five bits: 31 is 255, 1 is 8.
  expect_units(read(tga_head(2, 2, 1, 16, 0x20) + "\x00\x7c\x00\x04"s),
               std::vector<double>{1.0, 0, 0, 8.0 / 255, 0, 0});
  expect_units(
      read(tga_head(1, 2, 1, 8, 0x20, 2) + "\x03\x02\x01\x06\x05\x04"s + "\x01\x00"s),
      std::vector<double>{4.0 / 255, 5.0 / 255, 6.0 / 255, 1.0 / 255, 2.0 / 255, 3.0 / 255});
  EXPECT_THROW(
      (void)read(tga_head(1, 2, 1, 8, 0x20, 2) + "\x03\x02\x01\x06\x05\x04"s + "\x02\x00"s),
      Error);
  EXPECT_THROW((void)read(tga_head(2, 2, 2, 24, 0) + pixels.substr(1)), Error);
}

/// Half, float and integer channels, scan lines and tiles; alpha and depth are no colours.
TEST(ReadExr, TakesTheColoursOfTheFirstLayer) {
  const TemporaryFolder folder;
  constexpr int kSide = 40;
  struct Case {
    std::vector<std::string> names;
    std::vector<float> expected;
  };
  for (const Case& one :
       {Case{{"A", "B", "G", "R", "Z"}, {3, 2, 1}}, Case{{"Y", "A", "Z"}, {0}},
        Case{{"left.B", "left.G", "left.R"}, {2, 1, 0}}, Case{{"X", "Y", "Z"}, {0, 1, 2}}}) {
    for (const bool is_tiled : {false, true}) {
      Imf::Header header(kSide, kSide);
      header.dataWindow() = Imath::Box2i({-3, 5}, {-3 + kSide - 1, 5 + kSide - 1});
      Imf::FrameBuffer frame;
      std::vector<std::vector<float>> planes(one.names.size());
      for (std::size_t c = 0; c < one.names.size(); ++c) {
        planes[c].assign(std::size_t{kSide} * kSide, static_cast<float>(c));
        header.channels().insert(one.names[c], Imf::Channel(Imf::FLOAT));
        frame.insert(one.names[c],
                     Imf::Slice::Make(Imf::FLOAT, planes[c].data(), header.dataWindow()));
      }
      const std::string path = folder / "a.exr";
      if (is_tiled) {
        header.setTileDescription(Imf::TileDescription(16, 16, Imf::MIPMAP_LEVELS));
        Imf::TiledOutputFile file(path.c_str(), header);
        for (int level = 0; level < file.numLevels(); ++level) {
          file.setFrameBuffer(frame);
          file.writeTiles(0, file.numXTiles(level) - 1, 0, file.numYTiles(level) - 1, level);
        }
      } else {
        Imf::OutputFile file(path.c_str(), header);
        file.setFrameBuffer(frame);
        file.writePixels(kSide);
      }
      const PictureFile picture = read_picture(path);
      ASSERT_EQ(picture.pixels.channels(), static_cast<int>(one.expected.size()));
      for (std::size_t i = 0; i < picture.pixels.pixels().size(); ++i) {
        EXPECT_EQ(picture.pixels.pixels()[i], one.expected[i % one.expected.size()]);
      }
    }
  }
}

TEST(PictureWithDepth, IsReadToTheBitAndOfWholePicturesAlone) {
  const TemporaryFolder folder;
  Image<float> light(3, 5, 3);
  Image<float> depth(3, 5, 1);
  for (std::size_t i = 0; i < light.pixels().size(); ++i) {
    light.pixels()[i] = 0.1F * static_cast<float>(i) - 1.0F;
  }
  for (std::size_t i = 0; i < depth.pixels().size(); ++i) {
    depth.pixels()[i] = i % 4 == 0 ? 1e10F : 100.1F + static_cast<float>(i);
  }
  const std::array layers = {PictureLayer{.channels = {"A"}, .image = depth.view()},
                             PictureLayer{.channels = {"Z"}, .image = depth.view()}};
  write_image(folder / "whole.exr", light.view(), 1.0, {}, layers);
  const PictureWithDepth read = read_picture_with_depth(folder / "whole.exr");
  ASSERT_EQ(read.light.width(), 5);
  ASSERT_EQ(read.light.height(), 3);
  EXPECT_TRUE(std::ranges::equal(read.light.pixels(), light.pixels()));
  EXPECT_TRUE(std::ranges::equal(read.depth.pixels(), depth.pixels()));
  const auto expect_refused = [&](const char* name, const char* why) {
    try {
      static_cast<void>(read_picture_with_depth(folder / name));
      FAIL() << name << " is read";
    } catch (const Error& error) {
      EXPECT_THAT(error.problem(), HasSubstr(why)) << name;
      EXPECT_THAT(error.where(), HasSubstr(name));
      EXPECT_FALSE(error.hint().empty());
    }
  };
  write_image(folder / "flat.exr", light.view());
  expect_refused("flat.exr", "has no channel Z");
  write_image(folder / "grey.exr", depth.view(), 1.0, {}, std::span(layers).last(1));
  expect_refused("grey.exr", "has no channel R");
  write_image(folder / "a.tif", light.view());
  expect_refused("a.tif", "not an OpenEXR file");
  write_cropped_image(folder / "part.exr", light.view(), 1.0,
                      {.x = 1, .y = 0, .full_width = 6, .full_height = 3},
                      std::span(layers).last(1));
  expect_refused("part.exr", "is a part of a larger picture");
  light(1, 2, 0) = std::numeric_limits<float>::quiet_NaN();
  write_image(folder / "nan.exr", light.view(), 1.0, {}, layers);
  expect_refused("nan.exr", "pixel (x 2, y 1) is not a finite number");
}

TEST(WriteCroppedImage, SaysWhichPartOfThePictureItIs) {
  const TemporaryFolder folder;
  Image<float> crop(3, 5, 3);
  Image<float> depth(3, 5, 1);
  for (std::size_t i = 0; i < crop.pixels().size(); ++i) {
    crop.pixels()[i] = static_cast<float>(i);
  }
  for (std::size_t i = 0; i < depth.pixels().size(); ++i) {
    depth.pixels()[i] = 100.0F + static_cast<float>(i);
  }
  const PictureLayer layer{.channels = {"Z"}, .image = depth.view()};
  const std::string path = folder / "crop.exr";
  write_cropped_image(path, crop.view(), 1.0,
                      {.x = 30, .y = 7, .full_width = 64, .full_height = 48},
                      std::span(&layer, 1));
  Imf::InputFile file(path.c_str());
  EXPECT_EQ(file.header().dataWindow(), Imath::Box2i({30, 7}, {34, 9}));
  EXPECT_EQ(file.header().displayWindow(), Imath::Box2i({0, 0}, {63, 47}));
  // In the coordinates of the larger picture, the way other programs read it.
  std::vector<float> green(std::size_t{64} * 48, -1.0F);
  std::vector<float> far(std::size_t{64} * 48, -1.0F);
  const auto slice = [](std::vector<float>& plane) {
    return Imf::Slice::Make(Imf::FLOAT, plane.data(), Imath::V2i(0, 0), 64, 48);
  };
  Imf::FrameBuffer frame;
  frame.insert("G", slice(green));
  frame.insert("Z", slice(far));
  file.setFrameBuffer(frame);
  file.readPixels(7, 9);
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 64; ++x) {
      const bool is_within = x >= 30 && x < 35 && y >= 7 && y < 10;
      const std::size_t i =
          std::size_t{64} * static_cast<std::size_t>(y) + static_cast<std::size_t>(x);
      EXPECT_EQ(green[i], is_within ? crop(y - 7, x - 30, 1) : -1.0F);
      EXPECT_EQ(far[i], is_within ? depth(y - 7, x - 30) : -1.0F);
    }
  }
  // Ours reads the part alone; a whole picture has the bytes that it always had.
  const PictureFile read = read_picture(path);
  EXPECT_TRUE(std::ranges::equal(read.pixels.pixels(), crop.pixels()));
  write_cropped_image(folder / "whole.exr", crop.view(), 1.0,
                      {.full_width = 5, .full_height = 3});
  write_image(folder / "plain.exr", crop.view());
  EXPECT_EQ(read_file(folder / "whole.exr"), read_file(folder / "plain.exr"));
}

TEST(ReadExr, MakesFloatsOfHalvesAndUnitsOfIntegers) {
  const TemporaryFolder folder;
  const std::array<std::uint16_t, 4> halves{0x3c00, 0x0001, 0xc000, 0x7bff};
  const std::array<std::uint32_t, 4> integers{0, 1U << 31U, 4294967295U, 12345};
  const std::string path = folder / "a.exr";
  for (const Imf::PixelType type : {Imf::HALF, Imf::UINT}) {
    Imf::Header header(4, 1);
    header.channels().insert("Y", Imf::Channel(type));
    Imf::FrameBuffer frame;
    const void* data =
        type == Imf::HALF ? static_cast<const void*>(halves.data()) : integers.data();
    frame.insert("Y", Imf::Slice::Make(type, data, header.dataWindow()));
    {
      Imf::OutputFile file(path.c_str(), header);
      file.setFrameBuffer(frame);
      file.writePixels(1);
    }
    const PictureFile picture = read_picture(path);
    EXPECT_EQ(picture.is_floating, type == Imf::HALF);
    EXPECT_EQ(picture.bits_per_sample, type == Imf::HALF ? 16 : 32);
    expect_units(picture, type == Imf::HALF
                              ? std::vector<double>{1.0, 0x1p-24, -2.0, 65504.0}
                              : std::vector<double>{0.0, 0.5, 1.0, 12345.0 / 4294967295.0});
  }
}

TiffForm sensor_form() {
  return {.width = 64, .height = 48, .bits = 16, .photometric = PHOTOMETRIC_CFA};
}

/// A DNG of a sensor whose colours are linear sRGB's: red, green, green, blue; black 1000,
/// white 15000. The values are what a flat field of that light gives, times `scale`.
void write_dng(const std::filesystem::path& path, double r, double g, double b) {
  constexpr double kBlack = 1000.0;
  constexpr double kWhite = 15000.0;
  const TiffForm form = sensor_form();
  std::vector<std::uint16_t> values;
  for (int y = 0; y < form.height; ++y) {
    for (int x = 0; x < form.width; ++x) {
      const double light = y % 2 == 0 ? (x % 2 == 0 ? r : g) : (x % 2 == 0 ? g : b);
      values.push_back(static_cast<std::uint16_t>(
          std::lround(std::min(kBlack + light * (kWhite - kBlack), kWhite))));
    }
  }
  testing::write_dng(path, form, values, kBlack, kWhite);
}

TEST(ReadRaw, GivesLinearLightOfTheSensorWithADaylightWhite) {
  const TemporaryFolder folder;
  write_dng(folder / "a.dng", 0.4, 0.2, 0.1);
  const PictureFile picture = read_picture(folder / "a.dng");
  EXPECT_EQ(picture.transfer, Transfer::linear);
  EXPECT_EQ(picture.bits_per_sample, 16);
  ASSERT_EQ(picture.pixels.channels(), 3);
  ASSERT_EQ(picture.pixels.width(), 64);
  const Image<float> light = read_linear_image(folder / "a.dng");
  // A code of the sensor is 1/14000; the file's matrix has four digits, through which each
  // colour leaks into the others: 5e-4 of the brightest.
  constexpr double kTolerance = 1.0 / 14000.0 + 5e-4;
  for (int y = 4; y < 44; ++y) {
    for (int x = 4; x < 60; ++x) {
      ASSERT_NEAR(light(y, x, 0), 0.4, kTolerance);
      ASSERT_NEAR(light(y, x, 1), 0.2, kTolerance);
      ASSERT_NEAR(light(y, x, 2), 0.1, kTolerance);
    }
  }
}

/// No automatic brightness, white balance or white: dcraw would take the brightest value of 0.9
/// for the sensor's white.
TEST(ReadRaw, DoesNotDependOnThePicture) {
  const TemporaryFolder folder;
  for (const double scale : {1.0, 0.01}) {
    write_dng(folder / "a.dng", 0.9 * scale, 0.6 * scale, 0.5 * scale);
    const Image<float> light = read_linear_image(folder / "a.dng");
    const double tolerance = 1.0 / 14000.0 + 5e-4 * 0.9 * scale;
    EXPECT_NEAR(light(20, 20, 0), 0.9 * scale, tolerance);
    EXPECT_NEAR(light(20, 20, 1), 0.6 * scale, tolerance);
    EXPECT_NEAR(light(20, 20, 2), 0.5 * scale, tolerance);
  }
}

TEST(ReadRaw, MarksWhatTheSensorCouldNotHold) {
  const TemporaryFolder folder;
  write_dng(folder / "a.dng", 1.5, 0.2, 0.1);  // red saturates
  const PictureFile picture = read_picture(folder / "a.dng");
  for (int c = 0; c < 3; ++c) {
    EXPECT_EQ(picture.pixels(20, 20, c), 1.0F);
  }
}

TEST(ReadRaw, RefusesACutOneAndLeavesPlainTiffsAlone) {
  const TemporaryFolder folder;
  write_dng(folder / "a.dng", 0.4, 0.2, 0.1);
  const std::string bytes = read_file(folder / "a.dng");
  write_file_atomically(folder / "b.dng", std::string_view(bytes).substr(0, bytes.size() / 2));
  EXPECT_THAT(message_of(folder / "b.dng"), HasSubstr("cannot be decoded"));
  EXPECT_TRUE(is_raw(std::as_bytes(std::span(bytes))));
  write_tiff(folder / "a.tif", {.width = 16, .height = 16}, noise(256));
  const std::string plain = read_file(folder / "a.tif");
  EXPECT_FALSE(is_raw(std::as_bytes(std::span(plain))));
}

}  // namespace
}  // namespace haarlight
