// SPDX-License-Identifier: Apache-2.0
#include "core/picture/picture_colour.h"

#include <cmath>

#include <Eigen/Core>
#include <Eigen/LU>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <lcms2.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "tests/core/picture/picture_files.h"
#include "tests/temporary_folder.h"

namespace haarlight {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using ::testing::HasSubstr;
using testing::message_of;
using testing::TemporaryFolder;
using testing::write_jpeg;
using testing::write_png;
using testing::write_tiff;

/// Red, green, blue; x and y each. All with the white of D65, so that nothing is adapted
/// between white points on the way to Rec. 709.
constexpr Chromaticities kRec709{0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290};
constexpr Chromaticities kAdobe{0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290};
constexpr Chromaticities kDisplayP3{0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.3290};

/// XYZ of red, green and blue light as columns, such that their sum is white of luminance 1.
Matrix3d xyz_from_rgb(const Chromaticities& c) {
  const auto xyz = [](double x, double y) { return Vector3d(x / y, 1.0, (1.0 - x - y) / y); };
  Matrix3d m;
  m << xyz(c[0], c[1]), xyz(c[2], c[3]), xyz(c[4], c[5]);
  const Vector3d fraction = m.inverse() * xyz(c[6], c[7]);
  return m * fraction.asDiagonal();
}

Vector3d rec709_of(const Chromaticities& from, const Vector3d& linear) {
  return xyz_from_rgb(kRec709).inverse() * xyz_from_rgb(from) * linear;
}

std::string bytes_of_profile(cmsHPROFILE profile) {
  cmsUInt32Number size = 0;
  cmsSaveProfileToMem(profile, nullptr, &size);
  std::string bytes(size, '\0');
  cmsSaveProfileToMem(profile, bytes.data(), &size);
  cmsCloseProfile(profile);
  return bytes;
}

std::string profile_of(const Chromaticities& c, double gamma) {
  const cmsCIExyY white{c[6], c[7], 1.0};
  const cmsCIExyYTRIPLE primaries{{c[0], c[1], 1.0}, {c[2], c[3], 1.0}, {c[4], c[5], 1.0}};
  cmsToneCurve* curve = cmsBuildGamma(nullptr, gamma);
  cmsToneCurve* curves[3] = {curve, curve, curve};
  std::string bytes = bytes_of_profile(cmsCreateRGBProfile(&white, &primaries, curves));
  cmsFreeToneCurve(curve);
  return bytes;
}

std::string grey_profile(double gamma) {
  const cmsCIExyY white{0.3127, 0.3290, 1.0};
  cmsToneCurve* curve = cmsBuildGamma(nullptr, gamma);
  std::string bytes = bytes_of_profile(cmsCreateGrayProfile(&white, curve));
  cmsFreeToneCurve(curve);
  return bytes;
}

std::string srgb_profile() { return bytes_of_profile(cmsCreate_sRGBProfile()); }

/// 16 x 16 pixels of one colour: a JPEG's block transform leaves them as they are to a code.
constexpr int kSide = 16;
std::vector<std::uint8_t> flat(const std::vector<std::uint8_t>& pixel) {
  std::vector<std::uint8_t> samples;
  for (int i = 0; i < kSide * kSide; ++i) {
    samples.insert(samples.end(), pixel.begin(), pixel.end());
  }
  return samples;
}

Vector3d linear_of(const std::vector<std::uint8_t>& pixel, double gamma) {
  return {std::pow(pixel[0] / 255.0, gamma), std::pow(pixel[1] / 255.0, gamma),
          std::pow(pixel[2] / 255.0, gamma)};
}

/// A profile's numbers have 16 bits behind the point, so do the curve's power and the nine of
/// the matrix: 1e-4 over all is some six of their last digits.
constexpr double kProfileRounding = 1e-4;

void expect_pixel(const Image<float>& picture, const Vector3d& expected, double tolerance) {
  for (int c = 0; c < 3; ++c) {
    EXPECT_NEAR(picture(3, 5, c), expected(c), tolerance) << c;
  }
}

TEST(ColourProfile, IsHonouredInPngTiffAndJpeg) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> pixel{180, 90, 40};
  const std::vector<std::uint8_t> samples = flat(pixel);
  for (const auto& [primaries, gamma] : {std::pair(kAdobe, 563.0 / 256.0),
                                         std::pair(kDisplayP3, 2.2), std::pair(kRec709, 1.8)}) {
    const std::string icc = profile_of(primaries, gamma);
    const Vector3d expected = rec709_of(primaries, linear_of(pixel, gamma));
    write_png(folder / "a.png", {.width = kSide, .height = kSide, .icc = icc}, samples);
    write_tiff(folder / "a.tif",
               {.width = kSide,
                .height = kSide,
                .samples = 3,
                .photometric = PHOTOMETRIC_RGB,
                .icc = icc},
               samples);
    // In pieces of 100 bytes, as long profiles are cut.
    write_jpeg(folder / "a.jpg",
               {.width = kSide, .height = kSide, .icc = icc, .icc_piece = 100}, samples);
    for (const std::string name : {"a.png", "a.tif", "a.jpg"}) {
      // A JPEG's colours are rounded to codes twice: two codes at the curve's steepest,
      // 2.2/255.
      const double tolerance = name == "a.jpg" ? 2.0 * 2.2 / 255.0 : kProfileRounding;
      expect_pixel(read_linear_image(folder / name), expected, tolerance);
      const PictureFile file = read_picture(folder / name);
      EXPECT_NE(file.colours, nullptr) << name;
      EXPECT_THAT(file.profile, HasSubstr("RGB")) << name;
    }
  }
}

/// The codes as linear light where nothing says otherwise.
TEST(ColourProfile, OfSrgbChangesNoValueByOneBit) {
  const TemporaryFolder folder;
  std::vector<std::uint8_t> samples;
  for (int i = 0; i < kSide * kSide * 3; ++i) {
    samples.push_back(static_cast<std::uint8_t>(i * 7));
  }
  const auto read = [&](const testing::PngForm& form) {
    write_png(folder / "a.png", form, samples);
    EXPECT_EQ(read_picture(folder / "a.png").colours, nullptr);
    return read_linear_image(folder / "a.png");
  };
  testing::PngForm form{.width = kSide, .height = kSide};
  const Image<float> plain = read(form);
  form.icc = srgb_profile();
  const Image<float> with_profile = read(form);
  form.icc.clear();
  form.gamma = 1.0 / 2.2;  // what encoders write for sRGB
  form.primaries = {0.3127, 0.3290, 0.64, 0.33, 0.30, 0.60, 0.15, 0.06};
  const Image<float> with_chunks = read(form);
  for (std::size_t i = 0; i < samples.size(); ++i) {
    ASSERT_EQ(plain.pixels()[i],
              linear_from_srgb(static_cast<float>(samples[i]) * (1.0F / 255.0F)));
    ASSERT_EQ(with_profile.pixels()[i], plain.pixels()[i]);
    ASSERT_EQ(with_chunks.pixels()[i], plain.pixels()[i]);
  }
}

TEST(ColourProfile, OfLinearLightLeavesTheNumbers) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> pixel{180, 90, 40};
  write_png(folder / "a.png",
            {.width = kSide, .height = kSide, .icc = profile_of(kRec709, 1.0)}, flat(pixel));
  EXPECT_EQ(read_picture(folder / "a.png").transfer, Transfer::linear);
  expect_pixel(read_linear_image(folder / "a.png"), linear_of(pixel, 1.0), 1e-7);
  write_png(folder / "b.png", {.width = kSide, .height = kSide, .gamma = 1.0}, flat(pixel));
  EXPECT_EQ(read_picture(folder / "b.png").transfer, Transfer::linear);
}

TEST(ColourProfile, OfGreyIsItsCurve) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> samples = flat({100});
  const testing::PngForm grey{
      .width = kSide, .height = kSide, .colour = PNG_COLOR_TYPE_GRAY, .icc = grey_profile(1.8)};
  write_png(folder / "a.png", grey, samples);
  EXPECT_NEAR(read_linear_image(folder / "a.png")(0, 0), std::pow(100.0 / 255.0, 1.8),
              kProfileRounding);
  // Programs leave the profile of the colours in a picture made grey. libpng would drop it.
  write_tiff(folder / "a.tif",
             {.width = kSide, .height = kSide, .icc = profile_of(kAdobe, 1.8)}, samples);
  EXPECT_NEAR(read_linear_image(folder / "a.tif")(0, 0), std::pow(100.0 / 255.0, 1.8),
              kProfileRounding);
}

/// A scanner's profile holds a table of colours, which a linear one fills without error.
TEST(ColourProfile, MayBeATable) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> pixel{180, 90, 40};
  const std::string matrix = profile_of(kAdobe, 1.0);
  cmsHPROFILE from =
      cmsOpenProfileFromMem(matrix.data(), static_cast<cmsUInt32Number>(matrix.size()));
  cmsHPROFILE to = cmsCreateXYZProfile();
  cmsHTRANSFORM transform =
      cmsCreateTransform(from, TYPE_RGB_16, to, TYPE_XYZ_16, INTENT_RELATIVE_COLORIMETRIC,
                         cmsFLAGS_FORCE_CLUT | cmsFLAGS_LOWRESPRECALC);
  cmsHPROFILE table = cmsTransform2DeviceLink(transform, 4.3, cmsFLAGS_GUESSDEVICECLASS);
  EXPECT_NE(cmsIsTag(table, cmsSigAToB0Tag), 0);
  const std::string icc = bytes_of_profile(table);
  cmsDeleteTransform(transform);
  cmsCloseProfile(from);
  cmsCloseProfile(to);
  write_tiff(folder / "a.tif",
             {.width = kSide,
              .height = kSide,
              .samples = 3,
              .photometric = PHOTOMETRIC_RGB,
              .icc = icc},
             flat(pixel));
  // The table's entries have 16 bits for XYZ up to 2, of which Rec. 709's red takes 3.2 and
  // more.
  constexpr double kTolerance = 5.0 * 2.0 / 65535.0 + kProfileRounding;
  expect_pixel(read_linear_image(folder / "a.tif"), rec709_of(kAdobe, linear_of(pixel, 1.0)),
               kTolerance);
}

TEST(ColourProfile, IsRefusedWhereItIsDamagedOrOfAnotherKind) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> samples = flat({100, 100, 100});
  const std::string good = profile_of(kAdobe, 2.2);
  testing::TiffForm form{
      .width = kSide, .height = kSide, .samples = 3, .photometric = PHOTOMETRIC_RGB};
  const auto message = [&](const std::string& icc) {
    form.icc = icc;
    write_tiff(folder / "a.tif", form, samples);
    return message_of(folder / "a.tif");
  };
  EXPECT_THAT(message("no profile at all"), HasSubstr("its colour profile is damaged"));
  EXPECT_THAT(message(good.substr(0, 200)), HasSubstr("is damaged"));
  std::string without_red = good;
  without_red.replace(without_red.find("rXYZ"), 4, "rXYY");
  EXPECT_THAT(message(without_red), HasSubstr("is damaged"));
  EXPECT_THAT(message(grey_profile(2.2)), HasSubstr("is of grey pictures"));
  EXPECT_THAT(message(bytes_of_profile(cmsCreateInkLimitingDeviceLink(cmsSigCmykData, 300.0))),
              HasSubstr("is not of RGB or grey"));
  // JPEG: a piece is missing.
  write_jpeg(folder / "a.jpg", {.width = kSide, .height = kSide, .icc = good, .icc_piece = 200},
             samples);
  std::string bytes = read_file(folder / "a.jpg");
  const std::size_t second = bytes.find(std::string("ICC_PROFILE\0\2", 13));
  ASSERT_NE(second, std::string::npos);
  bytes[second] = 'X';
  write_file_atomically(folder / "a.jpg", bytes);
  EXPECT_THAT(message_of(folder / "a.jpg"), HasSubstr("its colour profile is damaged"));
  // PNG: one bit of the chunk is wrong.
  write_png(folder / "a.png", {.width = kSide, .height = kSide, .icc = good}, samples);
  bytes = read_file(folder / "a.png");
  bytes[bytes.find("iCCP") + 40] ^= 1;
  write_file_atomically(folder / "a.png", bytes);
  EXPECT_THAT(message_of(folder / "a.png"), HasSubstr("its colour profile is damaged"));
}

TEST(PngColours, AreHonouredWithoutAProfile) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> pixel{180, 90, 40};
  write_png(folder / "a.png", {.width = kSide, .height = kSide, .gamma = 1.0 / 1.8},
            flat(pixel));
  // gAMA has five digits: 1.8 to 2e-5.
  expect_pixel(read_linear_image(folder / "a.png"), linear_of(pixel, 1.8), kProfileRounding);
  EXPECT_EQ(read_picture(folder / "a.png").profile, "PNG's gAMA 0.55556");
  write_png(folder / "b.png",
            {.width = kSide,
             .height = kSide,
             .primaries = {0.3127, 0.3290, 0.68, 0.32, 0.265, 0.69, 0.15, 0.06}},
            flat(pixel));
  Vector3d light;
  for (int c = 0; c < 3; ++c) {
    light(c) =
        linear_from_srgb(static_cast<float>(pixel[static_cast<std::size_t>(c)]) / 255.0F);
  }
  expect_pixel(read_linear_image(folder / "b.png"), rec709_of(kDisplayP3, light),
               kProfileRounding);
}

/// EXIF in little-endian: tags of the first directory, of EXIF's own, of interoperability's.
std::string exif_block(bool is_adobe) {
  const auto number = [](std::uint32_t value, int n) {
    std::string bytes;
    for (int i = 0; i < n; ++i) {
      bytes += static_cast<char>(value >> (8 * i) & 255U);
    }
    return bytes;
  };
  const auto entry = [&](unsigned tag, unsigned type, unsigned count, std::uint32_t value) {
    return number(tag, 2) + number(type, 2) + number(count, 4) + number(value, 4);
  };
  constexpr std::uint32_t kExif = 8 + 2 + 3 * 12 + 4;
  constexpr std::uint32_t kInterop = kExif + 2 + 6 * 12 + 4;
  constexpr std::uint32_t kData = kInterop + 2 + 12 + 4;
  std::string block = std::string("II*\0", 4) + number(8, 4);
  block += number(3, 2) + entry(0x110, 2, 7, kData) + entry(0x112, 3, 1, 6) +
           entry(0x8769, 4, 1, kExif) + number(0, 4);
  block += number(6, 2) + entry(0x829a, 5, 1, kData + 8) + entry(0x829d, 5, 1, kData + 16) +
           entry(0x8827, 3, 1, 400) + entry(0x9003, 2, 20, kData + 24) +
           entry(0xa001, 3, 1, is_adobe ? 0xffff : 1) + entry(0xa005, 4, 1, kInterop) +
           number(0, 4);
  block += number(1, 2) + entry(1, 2, 4, 0x00333052) + number(0, 4);  // "R03"
  block += std::string("CamX 1\0\0", 8) + number(1, 4) + number(125, 4) + number(56, 4) +
           number(10, 4) + std::string("2026:11:22 20:30:21\0", 20);
  return block;
}

TEST(Exif, IsCarriedAndCannotHurt) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> samples = flat({180, 90, 40});
  const std::string block = exif_block(false);
  write_jpeg(folder / "a.jpg", {.width = kSide, .height = kSide, .exif = block}, samples);
  const PictureFacts facts = read_picture_facts(folder / "a.jpg");
  EXPECT_EQ(facts.orientation, 6);
  EXPECT_EQ(facts.model, "CamX 1");
  EXPECT_EQ(facts.exposure_s, 1.0 / 125.0);
  EXPECT_EQ(facts.f_number, 5.6);
  EXPECT_EQ(facts.iso, 400.0);
  EXPECT_EQ(facts.taken, "2026:11:22 20:30:21");
  EXPECT_EQ(read_picture(folder / "a.jpg").facts.exposure_s, 1.0 / 125.0);
  // Cut anywhere, it says less and harms nobody.
  for (std::size_t n = 0; n < block.size(); ++n) {
    const std::string cut = block.substr(0, n);
    const PictureFacts less = exif_tags(std::as_bytes(std::span(cut))).facts;
    EXPECT_TRUE(!less.iso || less.iso == 400.0);
  }
}

TEST(Exif, MarksAdobeRgb) {
  const TemporaryFolder folder;
  const std::vector<std::uint8_t> pixel{180, 90, 40};
  write_jpeg(folder / "a.jpg", {.width = kSide, .height = kSide, .exif = exif_block(true)},
             flat(pixel));
  EXPECT_EQ(read_picture(folder / "a.jpg").profile, "Adobe RGB (1998), by EXIF");
  expect_pixel(read_linear_image(folder / "a.jpg"),
               rec709_of(kAdobe, linear_of(pixel, 563.0 / 256.0)), 2.0 * 2.2 / 255.0);
}

/// What we write says what it is, to others and to ourselves.
TEST(WriteImage, SaysItsColours) {
  const TemporaryFolder folder;
  Image<float> image(4, 5, 3);
  for (std::size_t i = 0; i < image.pixels().size(); ++i) {
    image.pixels()[i] = static_cast<float>(i) * 0.3F;
  }
  for (const std::string name : {"a.png", "a.tif", "a.exr"}) {
    write_image(folder / name, image.view());
    const PictureFile file = read_picture(folder / name);
    EXPECT_EQ(file.colours, nullptr) << name;
    EXPECT_EQ(file.transfer, name == "a.png" ? Transfer::srgb : Transfer::linear);
    const std::string first = read_file(folder / name);
    write_image(folder / name, image.view());
    EXPECT_TRUE(first == read_file(folder / name)) << name;
  }
  const std::string png = read_file(folder / "a.png");
  for (const std::string chunk : {"sRGB", "gAMA", "cHRM"}) {
    EXPECT_NE(png.find(chunk), std::string::npos) << chunk;
  }
  EXPECT_NE(read_file(folder / "a.exr").find("chromaticities"), std::string::npos);
  TIFF* tiff = TIFFOpen((folder / "a.tif").c_str(), "r");
  std::uint32_t size = 0;
  const void* icc = nullptr;
  ASSERT_EQ(TIFFGetField(tiff, TIFFTAG_ICCPROFILE, &size, &icc), 1);
  cmsHPROFILE profile = cmsOpenProfileFromMem(icc, size);
  ASSERT_NE(profile, nullptr);
  const auto* green = static_cast<cmsCIEXYZ*>(cmsReadTag(profile, cmsSigGreenColorantTag));
  EXPECT_NEAR(green->Y, 0.7169, 1e-4);  // of sRGB adapted to D50: IEC 61966-2-1's own profile
  cmsCloseProfile(profile);
  TIFFClose(tiff);
}

}  // namespace
}  // namespace haarlight
