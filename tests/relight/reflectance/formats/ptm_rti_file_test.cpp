// SPDX-License-Identifier: Apache-2.0
/// @file
/// `.ptm` and `.rti`: what is written is read back, by bytes made by hand, and what is refused.

#include <bit>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/reflectance/formats/ptm_file.h"
#include "haarlight/relight/reflectance/formats/quantise.h"
#include "haarlight/relight/reflectance/formats/rti_file.h"
#include "tests/relight/reflectance/formats/quantise_model.h"
#include "tests/relight/reflectance/formats/reflectance_truth.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

using testing::empty_model;
using testing::psnr_db;
using testing::smooth_coefficients;
using testing::spread_directions;
using testing::TemporaryFolder;

ReflectanceModel made_model(ReflectanceBasis basis, ReflectanceColour colour, int n_terms,
                            ScaleRule rule) {
  ReflectanceModel model = empty_model(basis, colour, n_terms);
  quantise(model, smooth_coefficients(24, 40, n_planes_of(colour, n_terms)).view(), rule);
  return model;
}

void expect_same(const ReflectanceModel& found, const ReflectanceModel& truth) {
  ASSERT_EQ(found.planes.height(), truth.planes.height());
  ASSERT_EQ(found.planes.width(), truth.planes.width());
  EXPECT_EQ(found.basis, truth.basis);
  EXPECT_EQ(found.colour, truth.colour);
  EXPECT_EQ(found.n_terms, truth.n_terms);
  EXPECT_EQ(found.scales, truth.scales);
  EXPECT_TRUE(std::equal(found.planes.pixels().begin(), found.planes.pixels().end(),
                         truth.planes.pixels().begin(), truth.planes.pixels().end()));
}

/// The error that some bytes are refused with.
template <class Parse>
std::string refusal_of(const Parse& parse, const std::string& bytes) {
  try {
    (void)parse(bytes);
  } catch (const Error& error) {
    return error.what();
  }
  return "taken";
}

std::string ptm_refusal(const std::string& bytes) {
  return refusal_of([](const std::string& b) { return parse_ptm(b, "x.ptm"); }, bytes);
}
std::string rti_refusal(const std::string& bytes) {
  return refusal_of([](const std::string& b) { return parse_rti(b, "x.rti"); }, bytes);
}

class PtmForms : public ::testing::TestWithParam<ReflectanceColour> {};

TEST_P(PtmForms, ComeBackAsTheyWere) {
  const TemporaryFolder folder;
  const ReflectanceModel model =
      made_model(ReflectanceBasis::ptm, GetParam(), 6, ScaleRule::ptm);
  write_ptm(folder / "a.ptm", model);
  expect_same(read_ptm(folder / "a.ptm"), model);
  // No padding: the header, then just the planes.
  const std::string bytes = read_file(folder / "a.ptm");
  const std::size_t payload = std::size_t{24} * 40 * static_cast<std::size_t>(model.n_planes());
  EXPECT_EQ(bytes.substr(0, 8), "PTM_1.2\n");
  EXPECT_EQ(bytes[bytes.size() - payload - 1], '\n');
}

TEST_P(PtmForms, AsJpegKeepScalesAndPictures) {
  const TemporaryFolder folder;
  const ReflectanceModel model =
      made_model(ReflectanceBasis::ptm, GetParam(), 6, ScaleRule::ptm);
  write_ptm(folder / "a.ptm", model, {.is_jpeg = true, .quality = 95});
  const ReflectanceModel found = read_ptm(folder / "a.ptm");
  EXPECT_EQ(found.scales, model.scales);
  for (const Eigen::Vector3d& direction : spread_directions(5)) {
    EXPECT_GT(psnr_db(relit(found, direction).view(), relit(model, direction).view()), 40.0);
  }
}

INSTANTIATE_TEST_SUITE_P(All, PtmForms,
                         ::testing::Values(ReflectanceColour::rgb, ReflectanceColour::lrgb));

/// Two rows of one pixel: the lower row comes first in the file.
TEST(PtmFile, BytesStandWhereTheDescriptionSays) {
  const std::string head = "1\n2\n2 2 2 2 2 1\n0 0 0 0 0 100\n";
  std::string rgb = "PTM_1.2\nPTM_FORMAT_RGB\n" + head;
  for (int i = 0; i < 36; ++i) {
    rgb += static_cast<char>(i);
  }
  const ReflectanceModel colours = parse_ptm(rgb, "x.ptm");
  for (int c = 0; c < 3; ++c) {
    for (int j = 0; j < 6; ++j) {
      EXPECT_EQ(colours.planes(1, 0, 6 * c + j), 12 * c + j);
      EXPECT_EQ(colours.planes(0, 0, 6 * c + j), 12 * c + 6 + j);
    }
  }
  EXPECT_NEAR(colours.scales[5].offset, -100.0 / 255.0, 1e-15);
  EXPECT_NEAR(colours.scales[0].scale, 2.0 / 255.0, 1e-15);

  std::string lrgb = "PTM_1.2\nPTM_FORMAT_LRGB\n" + head;
  std::string old = "PTM_1.1\nPTM_FORMAT_LRGB\n" + head;  // nine bytes per pixel
  for (int i = 0; i < 18; ++i) {
    lrgb += static_cast<char>(i);
    old += static_cast<char>(i);
  }
  const ReflectanceModel two_blocks = parse_ptm(lrgb, "x.ptm");
  const ReflectanceModel one_block = parse_ptm(old, "x.ptm");
  for (int p = 0; p < 9; ++p) {
    EXPECT_EQ(two_blocks.planes(1, 0, p), p < 6 ? p : 12 + p - 6);
    EXPECT_EQ(two_blocks.planes(0, 0, p), p < 6 ? 6 + p : 15 + p - 6);
    EXPECT_EQ(one_block.planes(1, 0, p), p);
    EXPECT_EQ(one_block.planes(0, 0, p), 9 + p);
  }
}

TEST(PtmFile, HeadersOfOtherWritersRead) {
  const std::string pixels(9, '\x40');
  for (const char* head :
       {"PTM_1.2\r\nPTM_FORMAT_LRGB\r\n1\r\n1\r\n1 1 1 1 1 1\r\n0 0 0 0 0 0\r\n",
        "PTM_1.2\nPTM_FORMAT_LRGB\n1 1\n1.0 1 1 1e0 +1 1 \n-217 271 0 0 0 0  \n",
        "PTM_1.2\nPTM_FORMAT_LRGB\n1\n1\n1 1 1\n1 1 1\n0 0 0\n0 0 0\n"}) {
    EXPECT_EQ(ptm_refusal(std::string(head) + pixels), "taken") << head;
  }
}

TEST(PtmFile, WhatCannotBeReadIsRefusedWithItsPosition) {
  const std::string good = "PTM_1.2\nPTM_FORMAT_LRGB\n1\n1\n1 1 1 1 1 1\n0 0 0 0 0 0\n";
  const std::string pixels(9, '\0');
  ASSERT_EQ(ptm_refusal(good + pixels), "taken");
  struct Case {
    std::string bytes;
    std::string expected;
  };
  const auto changed = [&](const std::string& from, const std::string& to) {
    std::string bytes = good + pixels;
    return bytes.replace(bytes.find(from), from.size(), to);
  };
  for (const Case& c : {
           Case{"", "byte 0"},
           Case{"P6\n1 1\n255\n", "byte 0"},
           Case{good, "byte 52"},                     // no pixels
           Case{good + pixels + "x", "byte 61"},      // one too many
           Case{good + pixels.substr(1), "byte 60"},  // one missing
           Case{good.substr(0, 30), "byte"},          // within the header
           Case{changed("_LRGB", "_LUM"), "PTM_FORMAT_LUM"},
           Case{changed("_LRGB", "_PTM_C_LUT"), "byte 8"},
           Case{changed("_LRGB", "_JPEGLS_RGB"), "JPEGLS"},
           Case{changed("PTM_1.2", "PTM_9.9"), "PTM_9.9"},
           Case{changed("\n1\n1\n", "\n0\n1\n"), "width"},
           Case{changed("\n1\n1\n", "\n-3\n1\n"), "width"},
           Case{changed("\n1\n1\n", "\n1000000\n1000000\n"), "9000000000000"},
           Case{changed("\n1\n1\n", "\n99999999999999999999\n1\n"), "whole number"},
           Case{changed("1 1 1 1 1 1", "1 1 nan 1 1 1"), "finite"},
           Case{changed("1 1 1 1 1 1", "1 1 1e99 1 1 1"), "scale"},
           Case{changed("0 0 0 0 0 0", "0 0 0 0.5 0 0"), "bias"},
           Case{changed("0 0 0 0 0 0", "0 0 0 0 0 2000000000"), "bias"},
       }) {
    EXPECT_NE(ptm_refusal(c.bytes).find(c.expected), std::string::npos)
        << c.expected << " in: " << ptm_refusal(c.bytes);
  }
}

TEST(PtmFile, DamagedJpegFormsAreRefused) {
  const TemporaryFolder folder;
  const ReflectanceModel model =
      made_model(ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6, ScaleRule::ptm);
  write_ptm(folder / "a.ptm", model, {.is_jpeg = true});
  const std::string good = read_file(folder / "a.ptm");
  ASSERT_EQ(ptm_refusal(good), "taken");
  const auto changed = [&](const std::string& from, const std::string& to) {
    std::string bytes = good;
    return bytes.replace(bytes.find(from), from.size(), to);
  };
  EXPECT_NE(ptm_refusal(good.substr(0, good.size() - 1)).find("plane 8"), std::string::npos);
  EXPECT_NE(ptm_refusal(good + "x").find("too many"), std::string::npos);
  EXPECT_NE(ptm_refusal(changed("-1 -1 -1", "-1 -1 0")).find("reference"), std::string::npos);
  EXPECT_NE(ptm_refusal(changed("0 1 2 3 4", "1 0 2 3 4")).find("order"), std::string::npos);
  EXPECT_NE(
      ptm_refusal(changed("\n0 0 0 0 0 0 0 0 0", "\n0 0 7 0 0 0 0 0 0")).find("transform"),
      std::string::npos);
  EXPECT_NE(ptm_refusal(changed("\n40\n", "\n48\n")).find("48"), std::string::npos);
  // The first picture's size set to 65500 x 65500 in its own header: not believed.
  std::string huge = changed("\n40\n24\n", "\n65500\n65500\n");
  for (std::size_t at = huge.find("\xff\xc0"); at != std::string::npos;
       at = huge.find("\xff\xc0", at + 1)) {
    huge.replace(at + 5, 4, "\xff\xdc\xff\xdc");
  }
  EXPECT_NE(ptm_refusal(huge).find("65500 x 65500 pixels in"), std::string::npos)
      << ptm_refusal(huge);
  // Bytes of the first picture's end are missing; its size in the header says so.
  std::string short_scan = good;
  const std::size_t end = short_scan.find("\xff\xd9");
  short_scan.replace(end, 2, std::string(2, '\0'));
  EXPECT_NE(ptm_refusal(short_scan).find("JPEG"), std::string::npos) << ptm_refusal(short_scan);
}

class RtiTerms : public ::testing::TestWithParam<int> {};

TEST_P(RtiTerms, ComeBackAsTheyWere) {
  const TemporaryFolder folder;
  const ReflectanceModel model =
      made_model(ReflectanceBasis::hsh, ReflectanceColour::rgb, GetParam(), ScaleRule::rti);
  write_rti(folder / "a.rti", model);
  expect_same(read_rti(folder / "a.rti"), model);
  write_rti(folder / "b.rti", read_rti(folder / "a.rti"));
  EXPECT_EQ(read_file(folder / "b.rti"), read_file(folder / "a.rti"));
}

INSTANTIATE_TEST_SUITE_P(All, RtiTerms, ::testing::Values(4, 9, 16));

std::string floats(const std::vector<float>& values) {
  std::string bytes(values.size() * sizeof(float), '\0');
  std::memcpy(bytes.data(), values.data(), bytes.size());
  return bytes;
}

/// Two rows of one pixel, four terms; the first float begins with a CR, which is no line end.
TEST(RtiFile, BytesStandWhereTheDescriptionSays) {
  const auto strange = std::bit_cast<float>(0x3f80000dU);
  std::string payload = floats({strange, 2.0F, 3.0F, 4.0F, -0.5F, -1.0F, 0.0F, 0.25F});
  for (int i = 0; i < 24; ++i) {
    payload += static_cast<char>(200 + i);
  }
  for (const char* head : {"#HSH1.2\n3\n1 2 3\n4 2 1\n", "#HSH1.2\r\n3\r\n1 2 3\r\n4 2 1\r\n",
                           "#HSH1.2\n# made by hand\n#\n3\n1 2 3\n4 2 1\n"}) {
    const ReflectanceModel model = parse_rti(std::string(head) + payload, "x.rti");
    ASSERT_EQ(model.n_planes(), 12);
    for (int c = 0; c < 3; ++c) {
      for (int j = 0; j < 4; ++j) {
        EXPECT_EQ(model.planes(0, 0, 4 * c + j), 200 + 4 * c + j);
        EXPECT_EQ(model.planes(1, 0, 4 * c + j), 212 + 4 * c + j);
      }
    }
    EXPECT_DOUBLE_EQ(model.scales[0].scale * 255.0, static_cast<double>(strange));
    EXPECT_DOUBLE_EQ(model.scales[5].scale * 255.0, 2.0);
    EXPECT_DOUBLE_EQ(model.scales[8].offset, -0.5);
    EXPECT_DOUBLE_EQ(model.scales[11].offset, 0.25);
  }
}

TEST(RtiFile, WhatCannotBeReadIsRefusedWithItsPosition) {
  const std::string scales = floats(std::vector<float>(8, 1.0F));
  const std::string good = "#HSH1.2\n3\n1 1 3\n4 2 1\n";
  const std::string pixels(12, '\0');
  const std::string whole = good + scales + pixels;
  ASSERT_EQ(rti_refusal(whole), "taken");
  const auto changed = [&](const std::string& from, const std::string& to) {
    std::string bytes = whole;
    return bytes.replace(bytes.find(from), from.size(), to);
  };
  struct Case {
    std::string bytes;
    std::string expected;
  };
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (const Case& c : {
           Case{"", "byte 0"},
           Case{"#HSH1.2", "byte 0"},
           Case{"#HSH1.2\n", "byte 8"},
           Case{"#PTM1.2\n1\n1 1 3\n6 2 1\n", "byte 0"},
           Case{good, "byte 22"},
           Case{whole + "x", "byte 66"},
           Case{whole.substr(0, 60), "byte 60"},
           Case{changed("\n3\n", "\n1\n"), "file type 1"},
           Case{changed("1 1 3", "0 1 3"), "width"},
           Case{changed("1 1 3", "1 1 4"), "colours"},
           Case{changed("1 1 3", "1000000 1000000 3"), "12000000000032"},
           Case{changed("4 2 1", "5 2 1"), "5 terms"},
           Case{changed("4 2 1", "4 1 1"), "basis type 1"},
           Case{changed("4 2 1", "4 2 4"), "4 bytes"},
           Case{fmt::format("{}{}{}", good, floats({1, 1, 1, nan, 0, 0, 0, 0}), pixels),
                "term 3"},
           Case{fmt::format("{}{}{}", good, floats({1, 1, 1, 1, 0, -INFINITY, 0, 0}), pixels),
                "bias of term 1"},
       }) {
    EXPECT_NE(rti_refusal(c.bytes).find(c.expected), std::string::npos)
        << c.expected << " in: " << rti_refusal(c.bytes);
  }
}

TEST(RtiFile, TheOrder4SwitchIsTheReaders) {
  const TemporaryFolder folder;
  const ReflectanceModel model =
      made_model(ReflectanceBasis::hsh, ReflectanceColour::rgb, 16, ScaleRule::rti);
  write_rti(folder / "a.rti", model);
  const Eigen::Vector3d at = Eigen::Vector3d(0.6, 0.2, 0.5).normalized();
  ReflectanceModel rounded = model;
  rounded.order4 = HshOrder4::chi_rounding;
  const auto found = relit(read_rti(folder / "a.rti", HshOrder4::chi_rounding), at);
  EXPECT_EQ(psnr_db(found.view(), relit(rounded, at).view()), 200.0);
  EXPECT_LT(psnr_db(found.view(), relit(model, at).view()), 60.0);
}

TEST(Writers, ModelsThatAFileCannotHoldAreRefused) {
  const TemporaryFolder folder;
  const ReflectanceModel hsh =
      made_model(ReflectanceBasis::hsh, ReflectanceColour::rgb, 9, ScaleRule::rti);
  const ReflectanceModel ptm =
      made_model(ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6, ScaleRule::ptm);
  EXPECT_THROW(write_ptm(folder / "a.ptm", hsh), Error);
  EXPECT_THROW(write_rti(folder / "a.rti", ptm), Error);
  ReflectanceModel linear = ptm;
  linear.transfer = Transfer::linear;
  EXPECT_THROW(write_ptm(folder / "a.ptm", linear), Error);
  EXPECT_FALSE(std::filesystem::exists(folder / "a.ptm"));
}

}  // namespace
}  // namespace haarlight::relight
