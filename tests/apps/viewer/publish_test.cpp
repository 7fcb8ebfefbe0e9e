// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <fstream>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <zlib.h>

#include "apps/viewer/publish_basis.h"
#include "apps/viewer/publish_object.h"
#include "core/picture/png_tile.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/basis/haar.h"
#include "haarlight/relight/reflectance/formats/quantise.h"
#include "haarlight/relight/reflectance/formats/web_folder.h"
#include "tests/apps/viewer/small_basis.h"
#include "tests/relight/reflectance/formats/quantise_model.h"
#include "tests/relight/reflectance/formats/reflectance_truth.h"

namespace haarlight::apps {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

std::string text_of(const fs::path& path) { return read_file(path); }

/// What the published folder's page asks first.
Json about_of(const fs::path& site) {
  const Json mark = Json::parse(text_of(site / "published.json"));
  return Json::parse(text_of(site / mark.at("data").get<std::string>() / "about.json"));
}

class Publish : public ::testing::Test {
 protected:
  fs::path site(const std::string& name) { return folder_.path() / name; }
  PublishedBasis publish(const relight::BasisFile& basis, const std::string& name,
                         const PublishBasisOptions& options) {
    PublishFolder folder(site(name), "web", false);
    return publish_basis(basis, folder, options, {});
  }
  testing::TemporaryFolder folder_;
};

/// ||left out||^2 / ||T||^2 from the closed forms themselves, not from the file's tables.
double left_out_fraction(MemoryStack stack, const relight::HaarGrid& grid,
                         const Json& left_out) {  // at() is not const
  const StackDims dims = stack.dims();
  double left = 0.0;
  double all = 0.0;
  std::vector<double> row(static_cast<std::size_t>(dims.n_lights));
  for (int c = 0; c < dims.channels; ++c) {
    for (int y = 0; y < dims.height; ++y) {
      for (int x = 0; x < dims.width; ++x) {
        for (int k = 0; k < dims.n_lights; ++k) {
          row[static_cast<std::size_t>(k)] = double(stack.at(c, y, x, k));
          all += row[static_cast<std::size_t>(k)] * row[static_cast<std::size_t>(k)];
        }
        if (grid.size() > 0) {
          relight::haar_forward(std::span<double>(row), grid);
        }
        for (const Json& k : left_out) {
          left += row[k.get<std::size_t>()] * row[k.get<std::size_t>()];
        }
      }
    }
  }
  return left / all;
}

void expect_error_holds(const MemoryStack& stack, const relight::HaarGrid& grid,
                        const PublishedBasis& told, const Json& about) {
  const Json& left_out = about.at("published").at("left_out");
  EXPECT_EQ(static_cast<int>(left_out.size()), told.terms_all - told.terms);
  const double truth = std::sqrt(left_out_fraction(stack, grid, left_out));
  EXPECT_GT(truth, 0.0);
  // What is missing is at least the left-out part less the coding error, and at most both.
  EXPECT_GE(told.error, truth);
  EXPECT_LE(told.error, truth + 2.0 * told.own_error);
}

TEST_F(Publish, SaysWhatLeftOutLightsAndCoefficientsCost) {
  const relight::BasisFile import = test::small_import_basis(folder_.path());
  const PublishedBasis fewer = publish(import, "import", {.terms = 9});
  EXPECT_EQ(fewer.terms, 9);
  expect_error_holds(test::make_stack({.grid = 4, .channels = 3}), {}, fewer,
                     about_of(site("import")));

  const MemoryStack& stack = test::make_stack({.grid = 8});
  (void)relight::compress_stack(test::made_source(stack, 8), folder_.path() / "haar.hlb", {});
  const relight::BasisFile haar = relight::BasisFile::open(folder_.path() / "haar.hlb");
  const PublishedBasis within = publish(haar, "haar", {.max_error = 0.1});
  EXPECT_LE(within.error, 0.1);
  EXPECT_LT(within.terms, 64);
  expect_error_holds(stack, {8, 8}, within, about_of(site("haar")));
  // One term fewer would break it.
  const PublishedBasis less = publish(haar, "less", {.terms = within.terms - 1});
  EXPECT_GT(less.error, 0.1);

  const MemoryStack& wide = test::make_stack({.grid = 9, .rows = 5});
  (void)relight::compress_stack(test::made_source(wide, relight::HaarGrid{5, 9}),
                                folder_.path() / "wide.hlb", {});
  const PublishedBasis part =
      publish(relight::BasisFile::open(folder_.path() / "wide.hlb"), "wide", {.terms = 20});
  const Json about = about_of(site("wide"));
  expect_error_holds(wide, {5, 9}, part, about);
  EXPECT_EQ(about.at("lights").at("rows"), 5);
  EXPECT_EQ(about.at("lights").at("cols"), 9);
}

TEST_F(Publish, AFolderIsWholeOrNotThere) {
  const relight::BasisFile basis = test::small_import_basis(folder_.path());
  {
    PublishFolder folder(site("half"), "web", false);
    (void)folder.add_data("tables", "abc");
  }
  EXPECT_FALSE(fs::exists(site("half")));
  fs::create_directory(site("mine"));
  std::ofstream(site("mine") / "thesis.txt") << "mine";
  for (const bool replaces : {false, true}) {
    EXPECT_THROW(PublishFolder(site("mine"), "web", replaces), Error);
  }
  EXPECT_EQ(text_of(site("mine") / "thesis.txt"), "mine");
  (void)publish(basis, "site", {});
  const Json before = about_of(site("site"));
  EXPECT_THROW(PublishFolder(site("site"), "web", false), Error);
  {
    PublishFolder folder(site("site"), "web", true);
    (void)publish_basis(basis, folder, {.terms = 3}, {});
  }
  EXPECT_NE(about_of(site("site")).at("published"), before.at("published"));
  for (const auto& entry : fs::directory_iterator(folder_.path())) {
    EXPECT_EQ(entry.path().string().find(".tmp"), std::string::npos) << entry.path();
    EXPECT_EQ(entry.path().string().find(".old"), std::string::npos) << entry.path();
  }
}

TEST(PublishedPage, EscapesWhatUsersSayOfIt) {
  const std::string evil = "\"><script>alert('1')</script>&";
  for (const char* name : {"web/viewer/index.html", "web/viewer/reflectance.html"}) {
    const std::string page = published_page(text_of(name), "data 1 00000000",
                                            {.title = evil,
                                             .description = evil,
                                             .author = evil,
                                             .licence = "",
                                             .mm_per_pixel = {}});
    EXPECT_EQ(page.find("<script>"), std::string::npos);
    EXPECT_NE(page.find("Content-Security-Policy"), std::string::npos);
    EXPECT_EQ(page.find("\"../"), std::string::npos);
  }
  EXPECT_THROW((void)published_page("<html></html>", "", {}), Error);
  EXPECT_THROW((void)notes_text({.title = "\xff",
                                 .description = "",
                                 .author = "",
                                 .licence = "",
                                 .mm_per_pixel = {}}),
               Error);
}

TEST(PublishedFiles, GzipAndChecksumsAreZlibs) {
  const std::string text(100000, 'x');
  const std::string packed = gzipped(text);
  EXPECT_LT(packed.size(), 1000U);
  std::string back(text.size(), '\0');
  z_stream stream{};
  ASSERT_EQ(::inflateInit2(&stream, 15 + 16), Z_OK);
  std::string copy = packed;
  stream.next_in = reinterpret_cast<Bytef*>(copy.data());
  stream.avail_in = static_cast<uInt>(copy.size());
  stream.next_out = reinterpret_cast<Bytef*>(back.data());
  stream.avail_out = static_cast<uInt>(back.size());
  EXPECT_EQ(::inflate(&stream, Z_FINISH), Z_STREAM_END);
  ::inflateEnd(&stream);
  EXPECT_EQ(back, text);
  EXPECT_EQ(crc32_of("123456789"), "cbf43926");  // the check value of ISO 3309's polynomial
}

/// libpng reads the samples back.
TEST_F(Publish, PngTilesLoseNothing) {
  const auto sample = [](int y, std::size_t i) {
    return static_cast<std::uint8_t>(y * 37 + static_cast<int>(i) * 101 + (y * y) % 7);
  };
  const std::string png = encode_png(13, 29, [&](int y, std::span<std::uint8_t> row) {
    for (std::size_t i = 0; i < row.size(); ++i) {
      row[i] = sample(y, i);
    }
  });
  std::ofstream(site("tile.png"), std::ios::binary) << png;
  const PictureFile back = read_picture(site("tile.png"));
  ASSERT_EQ(back.pixels.height(), 13);
  ASSERT_EQ(back.pixels.width(), 29);
  for (int y = 0; y < 13; ++y) {
    for (int x = 0; x < 29; ++x) {
      for (int c = 0; c < 3; ++c) {
        EXPECT_EQ(std::lround(255.0F * back.pixels(y, x, c)),
                  sample(y, static_cast<std::size_t>(3 * x + c)));
      }
    }
  }
}

/// Sixteen terms of hsh, which OpenLIME has no word for, are published without info.json.
TEST_F(Publish, WhatOthersCannotReadIsLeftOutAndSaid) {
  for (const int terms : {9, 16}) {
    relight::ReflectanceModel model = testing::empty_model(
        relight::ReflectanceBasis::hsh, relight::ReflectanceColour::rgb, terms);
    relight::quantise(model, testing::smooth_coefficients(20, 30, 3 * terms).view());
    const std::string name = "hsh" + std::to_string(terms);
    PublishFolder folder(site(name), "web", false);
    const PublishedObject told = publish_object(model, name, folder, {}, {});
    EXPECT_EQ(told.has_info, terms == 9);
    EXPECT_EQ(fs::exists(site(name) / "info.json"), terms == 9);
    EXPECT_EQ(about_of(site(name)).at("model").at("terms"), terms);
  }
}

/// A page of a fit that has become too large goes: it would show the former one's pictures.
TEST_F(Publish, APageBesideAWebFolderComesAndGoes) {
  relight::ReflectanceModel model =
      testing::empty_model(relight::ReflectanceBasis::ptm, relight::ReflectanceColour::rgb, 6);
  relight::quantise(model, testing::smooth_coefficients(20, 30, 18).view());
  relight::write_web_folder(site("fit"), model);
  EXPECT_TRUE(add_page_to_web_folder(site("fit"), "web"));
  EXPECT_TRUE(fs::exists(site("fit") / "viewer/about.json"));
  EXPECT_EQ(relight::read_web_folder(site("fit")).planes.width(), 30);
  model.planes = Image<std::uint8_t>(1, 9000, 18);
  relight::write_web_folder(site("fit"), model);
  EXPECT_FALSE(add_page_to_web_folder(site("fit"), "web"));
  EXPECT_FALSE(fs::exists(site("fit") / "index.html"));
}

}  // namespace
}  // namespace haarlight::apps
