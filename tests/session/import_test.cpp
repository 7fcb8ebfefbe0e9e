// SPDX-License-Identifier: Apache-2.0
#include "haarlight/session/import/import.h"

#include <cmath>
#include <cstring>
#include <limits>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/session/develop/develop.h"
#include "session/verify.h"
#include "tests/core/picture/picture_files.h"
#include "tests/session/small_session.h"

namespace haarlight::session {
namespace {

namespace fs = std::filesystem;
using test::TemporaryFolder;
using ::testing::HasSubstr;

using Texts = std::vector<PictureNote>;

const fs::path kData = fs::path(HAARLIGHT_SOURCE_DIR) / "../shared/data";

Image<float> gradient(int height, int width, int channels, float seed) {
  Image<float> image(height, width, channels);
  for (std::size_t i = 0; i < image.pixels().size(); ++i) {
    image.pixels()[i] = 0.1F + 0.8F * std::abs(std::sin(seed + 0.37F * static_cast<float>(i)));
  }
  return image;
}

/// Three pictures of one ending and their list.
void write_capture(const fs::path& folder, const std::string& ending, int n = 3) {
  fs::create_directories(folder);
  std::string lp = fmt::format("{}\n", n);
  for (int k = 0; k < n; ++k) {
    const std::string name = fmt::format("light {}{}", k, ending);
    write_image(folder / name, gradient(9, 12, 3, static_cast<float>(k)).view());
    lp += fmt::format("{} {} 0 {}\n", name, 0.6 * (k % 2), k % 2 == 0 ? 1.0 : 0.8);
  }
  test::write_text(folder / "dirs.lp", lp);
}

std::string refusal(const fs::path& folder, const fs::path& lights, const fs::path& target,
                    const ImportOptions& options = {}) {
  try {
    (void)import_pictures(folder, lights, target, options);
  } catch (const Error& error) {
    EXPECT_FALSE(error.hint().empty()) << error.what();
    return error.what();
  }
  return "accepted";
}

/// Nothing half-written: neither the target nor a temporary folder beside it.
void expect_nothing_written(const fs::path& folder, const fs::path& target) {
  EXPECT_FALSE(fs::exists(target));
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    EXPECT_THAT(entry.path().filename().string(), ::testing::Not(HasSubstr(".import")));
  }
}

TEST(Import, KeepsDisplayPicturesAsCodedAndDevelopsThemLinear) {
  TemporaryFolder folder;
  write_capture(folder.path() / "in", ".png");
  const ImportResult result = import_pictures(
      folder.path() / "in", folder.path() / "in/dirs.lp", folder.path() / "out");
  EXPECT_EQ(result.info.form.transfer, Transfer::srgb);
  EXPECT_EQ(result.info.form.sample, SampleType::u8);
  const VerifyReport report = verify_session(folder.path() / "out");
  EXPECT_TRUE(report.is_good()) << report.problems[0];
  const LightStack stack = develop(Session::open(folder.path() / "out"));
  const Image<float> image = stack.light_images(1, 1).front();
  const Image<float> truth = gradient(9, 12, 3, 1.0F);
  for (std::size_t i = 0; i < image.pixels().size(); ++i) {
    // Half a code of 8 bits where the sRGB curve is steepest: 0.5/255 * 2.4/1.055 at white.
    ASSERT_NEAR(image.pixels()[i], truth.pixels()[i], 0.0046);
  }
}

TEST(Import, KeepsFloatingPicturesBitByBit) {
  TemporaryFolder folder;
  write_capture(folder.path() / "in", ".exr");
  const ImportResult result = import_pictures(
      folder.path() / "in", folder.path() / "in/dirs.lp", folder.path() / "out");
  EXPECT_EQ(result.info.form.sample, SampleType::f32);
  EXPECT_TRUE(verify_session(folder.path() / "out").is_good());
  const LightStack stack = develop(Session::open(folder.path() / "out"));
  const Image<float> image = stack.light_images(2, 1).front();
  const Image<float> truth = gradient(9, 12, 3, 2.0F);
  EXPECT_EQ(0, std::memcmp(image.pixels().data(), truth.pixels().data(),
                           truth.pixels().size() * sizeof(float)));
}

// A developer of raw files ends at 1; merged exposures and renderers end nowhere.
TEST(Import, FloatingValuesAboveOneAreNotClipped) {
  for (const float most : {1.0F, 1.5F, 4000.0F}) {
    TemporaryFolder folder;
    const fs::path in = folder.path() / "in";
    write_capture(in, ".exr");
    Image<float> bright = gradient(9, 12, 3, 1.0F);
    bright.pixels()[7] = most;
    bright.pixels()[30] = 1.0F;
    write_image(in / "light 1.exr", bright.view());
    const ImportResult result = import_pictures(in, in / "dirs.lp", folder.path() / "out");
    EXPECT_TRUE(verify_session(folder.path() / "out").is_good());
    const Developed developed = develop_all(Session::open(folder.path() / "out"));
    EXPECT_EQ(developed.n_saturated, most > 1.0F ? 0U : 2U) << most;
    EXPECT_EQ(result.notes.size(), most > 1.0F ? 1U : 0U);
  }
}

/// Frames know sRGB and linear alone: of any other profile the light itself is kept.
TEST(Import, AppliesAColourProfileUnlessTold) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  write_capture(in, ".png");
  for (int k = 0; k < 3; ++k) {
    const auto code = static_cast<std::uint8_t>(90 + 10 * k);
    const std::vector<std::uint8_t> samples(std::size_t{9} * 12 * 3, code);
    haarlight::testing::write_png(in / fmt::format("light {}.png", k),
                                  {.width = 12, .height = 9, .gamma = 1.0 / 1.8}, samples);
  }
  const ImportResult result = import_pictures(in, in / "dirs.lp", folder.path() / "out");
  EXPECT_EQ(result.info.form.sample, SampleType::f32);
  EXPECT_EQ(result.info.form.transfer, Transfer::linear);
  EXPECT_THAT(result.notes, ::testing::Contains(HasSubstr("gAMA 0.55556\") is applied")));
  const LightStack stack = develop(Session::open(folder.path() / "out"));
  // gAMA has five digits, a profile's power 16 bits: 1e-4 of the power.
  EXPECT_NEAR(stack.light_images(1, 1).front()(4, 5, 1), std::pow(100.0 / 255.0, 1.8), 1e-4);
  const ImportResult told =
      import_pictures(in, in / "dirs.lp", folder.path() / "told", {.transfer = Transfer::srgb});
  EXPECT_EQ(told.info.form.sample, SampleType::u8);
  EXPECT_THAT(told.notes, ::testing::Contains(HasSubstr("is not applied")));
}

TEST(Import, FramesOpenInAnotherTiffReader) {
  TemporaryFolder folder;
  write_capture(folder.path() / "in", ".png");
  (void)import_pictures(folder.path() / "in", folder.path() / "in/dirs.lp",
                        folder.path() / "out");
  // core's reader, which is not session's, reads what our encoder wrote.
  const PictureFile source = read_picture(folder.path() / "in/light 1.png");
  const PictureFile frame = read_picture(folder.path() / "out/frames/000001_a0.tif");
  ASSERT_EQ(frame.pixels.pixels().size(), source.pixels.pixels().size());
  EXPECT_EQ(frame.bits_per_sample, 8);
  EXPECT_TRUE(std::equal(frame.pixels.pixels().begin(), frame.pixels.pixels().end(),
                         source.pixels.pixels().begin()));
}

TEST(Import, RefusesByName) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  const fs::path out = folder.path() / "out";
  write_capture(in, ".exr");
  const std::string lp = test::read_text(in / "dirs.lp");

  test::write_text(in / "dirs.lp", "1\nlight 9.exr 0 0 1\n");
  EXPECT_THAT(refusal(in, in / "dirs.lp", out),
              AllOf(HasSubstr("\"light 9.exr\" is missing"), HasSubstr("is it \"light ")));
  test::write_text(in / "dirs.lp", lp);

  Image<float> broken = gradient(9, 12, 3, 1.0F);
  broken(4, 7, 2) = std::numeric_limits<float>::quiet_NaN();
  write_image(in / "light 1.exr", broken.view());
  EXPECT_THAT(refusal(in, in / "dirs.lp", out),
              AllOf(HasSubstr("light 1.exr"), HasSubstr("pixel (x 7, y 4)")));

  write_image(in / "light 1.exr", gradient(8, 12, 3, 1.0F).view());
  EXPECT_THAT(refusal(in, in / "dirs.lp", out),
              AllOf(HasSubstr("light 1.exr"), HasSubstr("12 x 8"), HasSubstr("12 x 9")));

  write_image(in / "light 1.exr", gradient(9, 12, 1, 1.0F).view());
  EXPECT_THAT(refusal(in, in / "dirs.lp", out),
              AllOf(HasSubstr("light 1.exr"), HasSubstr("grey")));

  test::write_text(in / "light 1.exr", "no picture");
  EXPECT_THAT(refusal(in, in / "dirs.lp", out), HasSubstr("light 1.exr"));

  fs::copy_file(in / "light 0.exr", in / "light 1.exr", fs::copy_options::overwrite_existing);
  EXPECT_THAT(refusal(in, in / "dirs.lp", out),
              AllOf(HasSubstr("light 1.exr"), HasSubstr("same bytes as light 0.exr")));

  EXPECT_THAT(refusal(in, in / "none.lp", out), HasSubstr("none.lp"));
  EXPECT_THAT(refusal(folder.path() / "none", in / "dirs.lp", out), HasSubstr("none"));
  expect_nothing_written(folder.path(), out);
}

TEST(Import, RefusesOneBadNumberIn1024PicturesByName) {
  constexpr int kPictures = 1024;
  constexpr int kBad = 517;
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  fs::create_directories(in);
  std::string lp = fmt::format("{}\n", kPictures);
  for (int k = 0; k < kPictures; ++k) {
    Image<float> picture = gradient(3, 4, 1, 0.01F * static_cast<float>(k));
    if (k == kBad) {
      picture(2, 1, 0) = std::numeric_limits<float>::quiet_NaN();
    }
    const std::string name = fmt::format("light_{:04}.tif", k);
    write_image(in / name, picture.view());
    const int from_middle = k - kPictures / 2;
    const double angle = 0.001 * from_middle;
    lp += fmt::format("{} {} 0 {}\n", name, std::sin(angle), std::cos(angle));
  }
  test::write_text(in / "dirs.lp", lp);
  const fs::path out = folder.path() / "out";
  EXPECT_THAT(refusal(in, in / "dirs.lp", out),
              AllOf(HasSubstr("light_0517.tif"), HasSubstr("pixel (x 1, y 2)")));
  expect_nothing_written(folder.path(), out);
}

TEST(Import, TakesPicturesInNaturalOrderWhenTheListNamesNone) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  fs::create_directories(in);
  for (const int k : {0, 2, 9, 10}) {
    write_image(in / fmt::format("p{}.png", k),
                gradient(4, 5, 3, static_cast<float>(k)).view());
  }
  write_image(in / "mask.png", gradient(4, 5, 3, 77.0F).view());
  write_image(in / "ambient.png", gradient(4, 5, 3, 78.0F).view());
  test::write_text(in / "l.lp", "4\n0 0 1\n0.6 0 0.8\n0 0.6 0.8\n0 -0.6 0.8\n");
  EXPECT_THAT(refusal(in, in / "l.lp", folder.path() / "out"), HasSubstr("6 pictures for 4"));
  const ImportResult result =
      import_pictures(in, in / "l.lp", folder.path() / "out",
                      {.match = {.exclude = {"mask"}, .dark = {"ambient.png"}}});
  ASSERT_EQ(result.info.lights.size(), 4U);
  EXPECT_EQ(result.info.lights[3].name, "p10.png");
  EXPECT_EQ(result.info.shots[4].kind, ShotKind::dark);
}

TEST(Import, FindsPicturesByBareNameWhenTheListCarriesAnothersPaths) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  write_capture(in, ".png", 2);
  test::write_text(in / "dirs.lp",
                   "2\nC:\\work\\light 0.png 0 0 1\n/nowhere/light 1.png 0.6 0 0.8\n");
  const ImportResult result = import_pictures(in, in / "dirs.lp", folder.path() / "out");
  EXPECT_EQ(result.info.lights.size(), 2U);
  ASSERT_EQ(result.disagreements.size(), 1U);
  EXPECT_THAT(result.disagreements[0],
              HasSubstr("C:\\work\\light 0.png, /nowhere/light 1.png"));
}

TEST(Import, ReplacesAnImportOnlyWhenForcedAndNeverACapture) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  const fs::path out = folder.path() / "out";
  write_capture(in, ".png");
  (void)import_pictures(in, in / "dirs.lp", out);
  EXPECT_THAT(refusal(in, in / "dirs.lp", out), HasSubstr("--force"));
  (void)import_pictures(in, in / "dirs.lp", out, {.force = true});
  EXPECT_TRUE(verify_session(out).is_good());
  test::make_small_session(folder.path() / "captured", 2);
  EXPECT_THAT(refusal(in, in / "dirs.lp", folder.path() / "captured", {.force = true}),
              HasSubstr("never a capture"));
  EXPECT_TRUE(verify_session(folder.path() / "captured").is_good());
}

TEST(Import, ReadsNoSessionOfMoreThan64MiBBeforeItReplacesIt) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  const fs::path out = folder.path() / "out";
  write_capture(in, ".png");
  (void)import_pictures(in, in / "dirs.lp", out);
  fs::resize_file(out / "session.json", (std::uintmax_t{64} << 20U) + 1);  // a hole
  EXPECT_THAT(
      refusal(in, in / "dirs.lp", out, {.force = true}),
      ::testing::AllOf(HasSubstr("session.json"), HasSubstr("67108865 bytes, more than")));
}

TEST(Import, SubtractsTheAmbientPicture) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  fs::create_directories(in);
  Image<float> lit(6, 6, 1);
  Image<float> ambient(6, 6, 1);
  for (std::size_t i = 0; i < lit.pixels().size(); ++i) {
    ambient.pixels()[i] = 0.05F + 0.001F * static_cast<float>(i);
    lit.pixels()[i] = ambient.pixels()[i] + 0.4F;
  }
  write_image(in / "a.exr", lit.view());
  write_image(in / "dark.exr", ambient.view());
  test::write_text(in / "l.lp", "1\na.exr 0 0 1\n");
  (void)import_pictures(in, in / "l.lp", folder.path() / "out",
                        {.match = {.dark = {"dark.exr"}}});
  const LightStack stack = develop(Session::open(folder.path() / "out"));
  for (const float value : stack.band(0)) {
    ASSERT_NEAR(value, 0.4F, 1e-6F);
  }
}

/// Frames of a card (columns 8 to 11) beside something green, under lamps of one warm colour;
/// 8 bit.
constexpr PixelRectangle kCard{8, 0, 4, 9};
constexpr float kWarm[3] = {0.9F, 0.6F, 0.4F};

Image<float> warm_picture(float level, float seed) {
  Image<float> image(9, 12, 3);
  for (int y = 0; y < 9; ++y) {
    for (int x = 0; x < 12; ++x) {
      for (int c = 0; c < 3; ++c) {
        const float rho = x >= 8 ? 0.9F : (c == 1 ? 0.5F : 0.2F);
        image(y, x, c) =
            level * kWarm[c] * rho + (x < 8 ? 0.01F * seed * static_cast<float>(x % 2) : 0.0F);
      }
    }
  }
  return image;
}

void write_warm_capture(const fs::path& folder, const std::string& ending, float level = 1.0F) {
  fs::create_directories(folder);
  std::string lp = "4\n";
  for (int k = 0; k < 4; ++k) {
    const std::string name = fmt::format("light {}{}", k, ending);
    write_image(folder / name, warm_picture(level * (0.4F + 0.15F * static_cast<float>(k)),
                                            static_cast<float>(k))
                                   .view());
    lp += fmt::format("{} {} 0 {}\n", name, 0.6 * (k % 2), k % 2 == 0 ? 1.0 : 0.8);
  }
  test::write_text(folder / "dirs.lp", lp);
}

/// The frames stay as the files are; what develop makes of them has the gains.
TEST(Import, AWhiteReferenceScalesWhatIsDevelopedAndNoFrame) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  write_warm_capture(in, ".png");
  const ImportResult plain = import_pictures(in, in / "dirs.lp", folder.path() / "plain");
  const ImportResult white = import_pictures(in, in / "dirs.lp", folder.path() / "white",
                                             {.white = WhitePatch{kCard, {}}});
  EXPECT_TRUE(plain.info.form.gains.empty());
  ASSERT_EQ(white.info.form.gains.size(), 3U);
  for (int k = 0; k < 4; ++k) {
    const auto i = static_cast<std::size_t>(k);
    EXPECT_EQ(plain.info.frames[i].evidence.pixel_hash,
              white.info.frames[i].evidence.pixel_hash);
  }
  // Half a code of 8 bits at blue's least, 0.9 * 0.4 * 0.4 = 0.144, which is 0.6 %.
  EXPECT_DOUBLE_EQ(white.info.form.gains[0], 1.0);
  EXPECT_NEAR(white.info.form.gains[1], 0.9 / 0.6, 0.006 * 1.5);
  EXPECT_NEAR(white.info.form.gains[2], 0.9 / 0.4, 0.006 * 2.25);
  EXPECT_THAT(white.notes, ::testing::Contains(HasSubstr("from 4 of 4 lights")));
  const VerifyReport report = verify_session(folder.path() / "white");
  EXPECT_TRUE(report.is_good()) << report.problems[0];
  const Session session = Session::open(folder.path() / "white");
  EXPECT_EQ(session.info().form.gains, white.info.form.gains);  // bit by bit through JSON
  const Image<float> scaled = develop(session).light_images(2, 1).front();
  const Image<float> as_is =
      develop(Session::open(folder.path() / "plain")).light_images(2, 1).front();
  for (std::size_t i = 0; i < scaled.pixels().size(); ++i) {
    const double wanted = as_is.pixels()[i] * white.info.form.gains[i % 3];
    ASSERT_NEAR(scaled.pixels()[i], wanted, 2e-7 * wanted);  // rounded to float twice
  }
  EXPECT_NEAR(scaled(4, 9, 1), scaled(4, 9, 0), 0.006 * scaled(4, 9, 0));
  EXPECT_NEAR(scaled(4, 9, 2), scaled(4, 9, 0), 0.006 * scaled(4, 9, 0));
  // Steps of one light are not alike any more: nothing may take them for whole multiples.
  EXPECT_TRUE(Developer(session, {}).steps().empty());
}

TEST(Import, AReflectanceAndADarkPictureGoIntoTheGains) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  write_warm_capture(in, ".exr");
  Image<float> dark(9, 12, 3);
  for (std::size_t i = 0; i < dark.pixels().size(); ++i) {
    dark.pixels()[i] = 0.02F + 0.03F * static_cast<float>(i % 3);
  }
  write_image(in / "dark.exr", dark.view());
  for (int k = 0; k < 4; ++k) {
    const fs::path file = in / fmt::format("light {}.exr", k);
    Image<float> lit = read_linear_image(file);
    for (std::size_t i = 0; i < lit.pixels().size(); ++i) {
      lit.pixels()[i] += dark.pixels()[i];
    }
    write_image(file, lit.view());
  }
  const ImportResult result =
      import_pictures(in, in / "dirs.lp", folder.path() / "out",
                      {.match = {.dark = {"dark.exr"}}, .white = WhitePatch{kCard, 0.9}});
  for (std::size_t c = 0; c < 3; ++c) {
    // Of 0.9 * warm * level the median level / cosine: 0.4, 0.55 / 0.8, 0.7, 0.85 / 0.8.
    const double wanted = 1.0 / (kWarm[c] * 0.5 * (0.55 / 0.8 + 0.7));
    EXPECT_NEAR(result.info.form.gains[c], wanted, 0.01 * wanted);
  }
  EXPECT_NEAR(result.info.form.gains[2] / result.info.form.gains[0], 0.9 / 0.4, 1e-5);
}

TEST(Import, AWhiteReferenceThatCannotBeUsedIsRefused) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  const fs::path out = folder.path() / "out";
  write_warm_capture(in, ".png");
  const auto refused = [&](const PixelRectangle& patch) {
    return refusal(in, in / "dirs.lp", out, {.white = WhitePatch{patch, {}}});
  };
  EXPECT_THAT(refused({8, 0, 5, 9}), HasSubstr("12 x 9"));
  write_warm_capture(in, ".png", 4.0F);
  EXPECT_THAT(refused(kCard), HasSubstr("clipped under 4"));
  write_warm_capture(in, ".png", 0.01F);
  EXPECT_THAT(refused(kCard), HasSubstr("dark under 4"));
  fs::remove_all(in);
  fs::create_directories(in);
  for (int k = 0; k < 2; ++k) {
    write_image(in / fmt::format("g{}.png", k),
                gradient(9, 12, 1, static_cast<float>(k)).view());
  }
  test::write_text(in / "dirs.lp", "2\ng0.png 0 0 1\ng1.png .6 0 .8\n");
  EXPECT_THAT(refused(kCard), HasSubstr("grey"));
  expect_nothing_written(folder.path(), out);
}

TEST(Import, ACropIsThatPartOfEveryPicture) {
  for (const char* ending : {".png", ".exr"}) {
    TemporaryFolder folder;
    const fs::path in = folder.path() / "in";
    write_capture(in, ending);
    (void)import_pictures(in, in / "dirs.lp", folder.path() / "whole");
    const ImportResult part = import_pictures(in, in / "dirs.lp", folder.path() / "part",
                                              {.crop = PixelRectangle{5, 2, 6, 7}});
    EXPECT_EQ(part.info.form.crop, (FrameCrop{5, 2, 12, 9}));
    EXPECT_THAT(part.notes, ::testing::Contains(HasSubstr("6 x 7 of 12 x 9")));
    const VerifyReport report = verify_session(folder.path() / "part");
    EXPECT_TRUE(report.is_good()) << report.problems[0];
    const Image<float> whole =
        develop(Session::open(folder.path() / "whole")).light_images(1, 1).front();
    const Image<float> image =
        develop(Session::open(folder.path() / "part")).light_images(1, 1).front();
    const Image<float> wanted = cut(whole, {5, 2, 6, 7});
    ASSERT_EQ(image.pixels().size(), wanted.pixels().size());
    EXPECT_EQ(0, std::memcmp(image.pixels().data(), wanted.pixels().data(),
                             wanted.pixels().size() * sizeof(float)));
    EXPECT_EQ(refusal(in, in / "dirs.lp", folder.path() / "all",
                      {.crop = PixelRectangle{0, 0, 12, 9}}),
              "accepted");
  }
}

/// What the whole picture was is under the frames' own hashes.
TEST(Import, AChangedCropOrGainIsFoundByVerify) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  write_warm_capture(in, ".png");
  for (const auto& [from, to] : {std::pair{"\"crop\":[1,2,12,9]", "\"crop\":[2,2,12,9]"},
                                 std::pair{"\"gains\":[1.0,", "\"gains\":[1.1,"}}) {
    const fs::path out = folder.path() / "out";
    (void)import_pictures(
        in, in / "dirs.lp", out,
        {.white = WhitePatch{kCard, {}}, .crop = PixelRectangle{1, 2, 10, 7}, .force = true});
    for (const char* name : {"session.json", "start.json"}) {
      std::string text = test::read_text(out / name);
      const std::size_t at = text.find(from);
      ASSERT_NE(at, std::string::npos) << from;
      text.replace(at, std::string(from).size(), to);
      test::write_text(out / name, text);
    }
    const VerifyReport report = verify_session(out);
    EXPECT_THAT(report.problems, ::testing::Contains(HasSubstr("frames/000000")));
  }
}

TEST(Import, ACropOutsideOrWithoutDifferencesIsRefused) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  const fs::path out = folder.path() / "out";
  write_capture(in, ".png");
  EXPECT_THAT(refusal(in, in / "dirs.lp", out, {.crop = PixelRectangle{0, 0, 13, 9}}),
              AllOf(HasSubstr("12 x 9"), HasSubstr("--crop")));
  EXPECT_THAT(refusal(in, in / "dirs.lp", out, {.crop = PixelRectangle{3, 3, 0, 2}}),
              HasSubstr("0 x 2"));
  for (int k = 0; k < 3; ++k) {  // the left half is the same under all lights
    Image<float> picture = gradient(9, 12, 3, static_cast<float>(k));
    for (int y = 0; y < 9; ++y) {
      for (int i = 0; i < 18; ++i) {
        picture(y, i / 3, i % 3) = 0.3F;
      }
    }
    write_image(in / fmt::format("light {}.png", k), picture.view());
  }
  EXPECT_THAT(refusal(in, in / "dirs.lp", out, {.crop = PixelRectangle{0, 0, 6, 9}}),
              AllOf(HasSubstr("same pixels in the crop"), HasSubstr("light 0.png")));
  expect_nothing_written(folder.path(), out);
}

/// Of pictures that the camera turned, rectangles are those that a viewer shows.
TEST(Import, RectanglesAreOfTheUprightPicture) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  fs::create_directories(in);
  constexpr int kWide = 6;  // stored; 4 wide and 6 high seen upright
  constexpr int kHigh = 4;
  const auto write = [&](int k, int orientation) {
    std::vector<std::uint8_t> samples;
    for (int y = 0; y < kHigh; ++y) {
      for (int x = 0; x < kWide; ++x) {
        // Orientation 6: the first row is seen at the right, the first column on top. The card
        // is the upper left 2 x 2 seen upright: columns 0 and 1 of the last two rows.
        const bool is_card = x < 2 && y >= 2;
        for (int c = 0; c < 3; ++c) {
          const int value =
              is_card ? (c == 2 ? 90 : 180) + 4 * k : 20 + 3 * (kWide * y + x) + k;
          samples.push_back(static_cast<std::uint8_t>(value));
        }
      }
    }
    haarlight::testing::write_tiff(in / fmt::format("t{}.tif", k),
                                   {.width = kWide,
                                    .height = kHigh,
                                    .samples = 3,
                                    .photometric = PHOTOMETRIC_RGB,
                                    .orientation = orientation},
                                   samples);
  };
  std::string lp = "3\n";
  for (int k = 0; k < 3; ++k) {
    write(k, 6);
    lp +=
        fmt::format("t{}.tif {} 0 {}\n", k, k == 0 ? 0.6 : -0.6 * (k - 1), k == 1 ? 1.0 : 0.8);
  }
  test::write_text(in / "dirs.lp", lp);
  const ImportResult result = import_pictures(
      in, in / "dirs.lp", folder.path() / "out",
      {.white = WhitePatch{{0, 0, 2, 2}, {}}, .crop = PixelRectangle{1, 3, 3, 2}});
  EXPECT_DOUBLE_EQ(result.info.form.gains[1], 1.0);
  const double blue = linear_from_srgb(184.0F / 255.0F) / linear_from_srgb(94.0F / 255.0F);
  EXPECT_NEAR(result.info.form.gains[2], blue, 1e-5 * blue);
  // Seen from column 1 and row 3: stored from column 3, rows 0 to 2.
  EXPECT_EQ(result.info.form.crop, (FrameCrop{3, 0, kWide, kHigh}));
  EXPECT_EQ(result.info.form.width, 2);
  EXPECT_EQ(result.info.form.height, 3);
  const PictureFile frame = read_picture(folder.path() / "out/frames/000000_a0.tif");
  EXPECT_NEAR(frame.pixels(0, 0, 0) * 255.0F, 20 + 3 * 3, 1e-3);
  EXPECT_THAT(
      refusal(in, in / "dirs.lp", folder.path() / "no", {.crop = PixelRectangle{0, 0, 5, 6}}),
      HasSubstr("4 x 6 seen upright"));
  write(1, 1);
  EXPECT_THAT(
      refusal(in, in / "dirs.lp", folder.path() / "no", {.crop = PixelRectangle{0, 0, 2, 2}}),
      AllOf(HasSubstr("t1.tif"), HasSubstr("turned otherwise")));
  expect_nothing_written(folder.path(), folder.path() / "no");
}

/// What the camera wrote stays with the session, and with what is made of it.
TEST(Import, KeepsWhatTheCameraWrote) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  write_capture(in, ".png");
  PictureFacts facts{
      .exposure_s = 0.5, .f_number = 8.0, .iso = 100.0, .model = "CamX", .taken = {}};
  for (int k = 0; k < 3; ++k) {
    facts.taken = fmt::format("2026:11:22 20:30:{}", 29 - k);
    facts.iso = k == 1 ? 200.0 : 100.0;
    write_image(in / fmt::format("light {}.png", k),
                gradient(9, 12, 3, static_cast<float>(k)).view(), 1.0,
                {.texts = {}, .facts = facts});
  }
  const ImportResult result = import_pictures(in, in / "dirs.lp", folder.path() / "out");
  facts.iso.reset();  // not the same of all
  EXPECT_EQ(result.info.photographed, facts);
  EXPECT_THAT(result.notes,
              ::testing::Contains("photographed: CamX, 1/2 s, f/8, 2026-11-22 20:30:27"));
  EXPECT_EQ(Session::open(folder.path() / "out").info().photographed, facts);
  EXPECT_TRUE(verify_session(folder.path() / "out").is_good());
  // A session's own text: damaged, it is refused by its position.
  const std::string json = session_info_to_json(result.info);
  for (const char* broken :
       {"\"exposure_s\":-1", "\"exposure_s\":\"x\"", "\"camera\":7", "\"camera\":\"a\\nb\""}) {
    std::string text = json;
    text.replace(text.find("\"exposure_s\":0.5"), 16, broken);
    EXPECT_THROW((void)session_info_from_json(text, "session.json"), Error) << broken;
  }
}

/// Whatever a file tells of its camera, the session that is made of it can be opened.
TEST(Import, NumbersThatNoCameraMeantAreUnknown) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  write_capture(in, ".exr");
  const float huge = std::numeric_limits<float>::max();
  const float tiny = std::numeric_limits<float>::denorm_min();
  const PictureFacts facts{
      .exposure_s = huge, .f_number = tiny, .iso = 100.0, .model = "CamX", .taken = {}};
  for (int k = 0; k < 3; ++k) {
    write_image(in / fmt::format("light {}.exr", k),
                gradient(9, 12, 3, static_cast<float>(k)).view(), 1.0,
                {.texts = {}, .facts = facts});
  }
  const fs::path out = folder.path() / "out";
  const ImportResult result = import_pictures(in, in / "dirs.lp", out);
  EXPECT_EQ(result.info.photographed, (PictureFacts{.orientation = 1,
                                                    .exposure_s = {},
                                                    .f_number = {},
                                                    .iso = 100.0,
                                                    .model = "CamX",
                                                    .taken = {}}));
  EXPECT_EQ(Session::open(out).info().photographed, result.info.photographed);
  EXPECT_TRUE(verify_session(out).is_good());
}

/// Pictures that say where their lights are, as `haarlight export --exr` writes them.
void write_noted(const fs::path& file, const Texts& notes, float seed) {
  write_image(file, gradient(9, 12, 3, seed).view(), 1.0, {.texts = notes, .facts = {}});
}

TEST(Import, TakesLightsThatThePicturesName) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  fs::create_directories(in);
  for (int k = 0; k < 11; ++k) {  // 10 comes behind 9
    write_noted(in / fmt::format("l{}.exr", k),
                {{"haarlightLightPosition", "1 2 3"},
                 {"haarlightLightFromObject", fmt::format("{} -20.25 1e3", 100 + k)},
                 {"haarlightLightLobe", "0 0 -1 1.5"}},
                static_cast<float>(k));
  }
  const ImportResult result = import_pictures(in, "", folder.path() / "out");
  ASSERT_EQ(result.info.lights.size(), 11U);
  for (int k = 0; k < 11; ++k) {
    const SessionLight& light = result.info.lights[static_cast<std::size_t>(k)];
    EXPECT_EQ(light.name, fmt::format("l{}.exr", k));
    EXPECT_TRUE(light.is_position);
    EXPECT_EQ(light.coordinates, Eigen::Vector3d(100.0 + k, -20.25, 1000.0));
    EXPECT_EQ(light.lobe, (LightLobe{-Eigen::Vector3d::UnitZ(), 1.5}));
  }
  const VerifyReport report = verify_session(folder.path() / "out");
  EXPECT_TRUE(report.is_good()) << report.problems[0];
}

TEST(Import, RefusesPicturesThatNameNoLightOrNoNumbers) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  const fs::path out = folder.path() / "out";
  fs::create_directories(in);
  write_noted(in / "a.exr", {{"haarlightLightDirection", "0 0 1"}}, 1.0F);
  const auto refused_with = [&](const Texts& notes) {
    write_noted(in / "b.exr", notes, 2.0F);
    std::string what = refusal(in, "", out);
    EXPECT_THAT(what, HasSubstr("b.exr"));
    return what;
  };
  EXPECT_THAT(refused_with({}), HasSubstr("does not say where its light is"));
  EXPECT_THAT(refused_with({{"haarlightLightPosition", "1 2 3"}}), HasSubstr("rig's frame"));
  EXPECT_THAT(refused_with({{"haarlightLightFromObject", "1 2 3"}}),
              HasSubstr("names a position"));
  for (const char* text : {"", "0 0", "0 0 1 ", "0 0 1 0", "0 0 x", "nan 0 1", "inf 0 0",
                           "0,0,1", "0 0 2", "0 0 0", "1e999 0 0"}) {
    EXPECT_THAT(refused_with({{"haarlightLightDirection", text}}),
                HasSubstr("haarlightLightDirection"))
        << text;
  }
  write_noted(in / "a.exr", {{"haarlightLightFromObject", "0 0 9"}}, 1.0F);
  for (const char* lobe : {"0 0 1", "0 0 2 1", "0 0 1 -1", "0 0 1 1e9"}) {
    EXPECT_THAT(
        refused_with({{"haarlightLightFromObject", "0 1 9"}, {"haarlightLightLobe", lobe}}),
        HasSubstr("haarlightLightLobe"))
        << lobe;
  }
  EXPECT_THAT(refused_with({{"haarlightLightFromObject", "0 0 0"}}), HasSubstr("length 0"));
  write_image(in / "c.png", gradient(9, 12, 3, 3.0F).view());
  write_noted(in / "b.exr", {{"haarlightLightFromObject", "0 1 9"}}, 2.0F);
  EXPECT_THAT(refusal(in, "", out), HasSubstr("c.png"));
  expect_nothing_written(folder.path(), out);
}

/// Where a picture was cut out of is kept, and added to.
TEST(Import, ACropOfACropLiesInTheFirstWhole) {
  TemporaryFolder folder;
  const fs::path in = folder.path() / "in";
  fs::create_directories(in);
  const auto write = [&](const char* crop) {
    for (int k = 0; k < 3; ++k) {
      Texts notes = {{"haarlightLightFromObject", fmt::format("{} 0 900", 70 * k)}};
      if (k < 2 || crop != nullptr) {
        notes.push_back({"haarlightCrop", crop == nullptr ? "5 6 40 30" : crop});
      }
      write_noted(in / fmt::format("l{}.exr", k), notes, static_cast<float>(k));
    }
  };
  write("5 6 40 30");
  EXPECT_EQ(import_pictures(in, "", folder.path() / "same").info.form.crop,
            (FrameCrop{5, 6, 40, 30}));
  EXPECT_EQ(import_pictures(in, "", folder.path() / "out", {.crop = PixelRectangle{2, 3, 8, 4}})
                .info.form.crop,
            (FrameCrop{7, 9, 40, 30}));
  EXPECT_TRUE(verify_session(folder.path() / "out").is_good());
  write(nullptr);
  EXPECT_THAT(refusal(in, "", folder.path() / "no"),
              AllOf(HasSubstr("l2.exr"), HasSubstr("cut out of 40 x 30 at (5, 6)")));
  for (const char* text : {"5 6 16 30", "-1 6 40 30", "5 6 40", "5.5 6 40 30", "0 0 1e9 1e9"}) {
    write(text);
    EXPECT_THAT(refusal(in, "", folder.path() / "no"), HasSubstr("haarlightCrop")) << text;
  }
}

struct RealCapture {
  const char* folder;
  const char* lights;
  std::vector<std::string> exclude;
  std::size_t n_lights;
  int width;
  int height;
  int channels;
};

/// GoogleTest's own name for it.
void PrintTo(const RealCapture& capture,  // NOLINT(readability-identifier-naming)
             std::ostream* out) {
  *out << capture.folder;
}

class RealImport : public ::testing::TestWithParam<RealCapture> {};

TEST_P(RealImport, BecomesASessionThatVerifiesAndDevelops) {
#if defined(__SANITIZE_THREAD__)
  GTEST_SKIP()
      << "a minute of numbers; the small imports show ThreadSanitizer the same threads";
#endif
  const RealCapture& capture = GetParam();
  const fs::path in = kData / capture.folder;
  if (!fs::exists(in)) {
    GTEST_SKIP() << in << " is not here";
  }
  TemporaryFolder folder;
  const ImportResult result = import_pictures(in, kData / capture.lights, folder.path() / "out",
                                              {.match = {.exclude = capture.exclude}});
  EXPECT_EQ(result.info.lights.size(), capture.n_lights);
  EXPECT_EQ(result.info.form.width, capture.width);
  EXPECT_EQ(result.info.form.height, capture.height);
  EXPECT_EQ(result.info.form.channels, capture.channels);
  const VerifyReport report = verify_session(folder.path() / "out");
  EXPECT_TRUE(report.is_good()) << report.problems[0];
  EXPECT_EQ(static_cast<std::size_t>(report.n_frames), capture.n_lights);
  const Session session = Session::open(folder.path() / "out");
  const LightStack stack = develop(session);
  // A light's picture read by another way, linearised at once.
  const std::size_t k = capture.n_lights / 2;
  const Image<float> truth =
      read_linear_image(in / fs::path(result.info.lights[k].name).filename());
  const Image<float> image = stack.light_images(static_cast<int>(k), 1).front();
  ASSERT_EQ(image.pixels().size(), truth.pixels().size());
  for (std::size_t i = 0; i < truth.pixels().size(); ++i) {
    ASSERT_NEAR(image.pixels()[i], truth.pixels()[i], 2e-6F) << i;  // i/255 rounded twice
  }
}

INSTANTIATE_TEST_SUITE_P(
    SharedData, RealImport,
    ::testing::Values(
        RealCapture{"rti_real/item1", "rti_real/item1/dirs.lp", {}, 60, 487, 439, 3},
        RealCapture{"balls/chrome", "balls/lights.txt", {"mask"}, 12, 512, 340, 3},
        RealCapture{"balls/gray", "balls/lights.txt", {"mask"}, 12, 512, 340, 3},
        RealCapture{"rti_synth/Single_Object1_material4/Test",
                    "rti_synth/Single_Object1_material4/Test/dirs.lp",
                    {},
                    20,
                    320,
                    320,
                    3},
        RealCapture{
            "formats/ptmfitter", "formats/ptmfitter/reference_8x5.lp", {}, 12, 8, 5, 3}),
    [](const ::testing::TestParamInfo<RealCapture>& capture) {
      return "Capture" + std::to_string(capture.index);
    });

TEST(RealImport, TakesEightLedsAndTheirAmbientPicture) {
  const fs::path in = kData / "rti_real/butterfly_8led";
  if (!fs::exists(in)) {
    GTEST_SKIP() << in << " is not here";
  }
  TemporaryFolder folder;
  std::string json = R"({"lights": [)";
  for (int k = 0; k < 8; ++k) {
    const double phi = k * 0.7853981633974483;
    json += fmt::format(R"({}{{"name": "image{}.png", "direction": [{}, {}, 0.7]}})",
                        k == 0 ? "" : ", ", k, 0.7 * std::cos(phi), 0.7 * std::sin(phi));
  }
  test::write_text(folder.path() / "lights.json", json + "]}");
  const ImportResult result =
      import_pictures(in, folder.path() / "lights.json", folder.path() / "out",
                      {.match = {.dark = {"image_ambient.png"}}});
  EXPECT_EQ(result.info.form.channels, 1);
  EXPECT_EQ(result.info.shots.size(), 9U);
  const VerifyReport report = verify_session(folder.path() / "out");
  EXPECT_TRUE(report.is_good()) << report.problems[0];
  EXPECT_EQ(develop(Session::open(folder.path() / "out")).dims().n_lights, 8);
}

}  // namespace
}  // namespace haarlight::session
