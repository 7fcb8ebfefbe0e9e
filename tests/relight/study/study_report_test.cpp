// SPDX-License-Identifier: Apache-2.0
#include "relight/study/study_report.h"

#include <cmath>
#include <cstdio>
#include <limits>
#include <string>
#include <utility>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "core/plot.h"

namespace haarlight::relight {
namespace {

/// Two bases of made numbers, one of which does not get there.
BasisStudy made_study() {
  BasisStudy study;
  study.dims = {4, 4, 1, 16};
  study.tile = 128;
  study.n_tiles = study.n_tiles_studied = 1;
  study.n_pixels = 16;
  study.region_pixels = {1, 2, 10, 0, 3};
  study.lightings = {"one light", "smooth"};
  for (const char* name : {"haar", "sh"}) {
    BasisResult result;
    result.name = name;
    result.title = std::string(name) == "haar" ? "Haar + plate" : "spherical harmonics";
    result.has_plate = std::string(name) == "haar";
    result.n_patterns = 16;
    for (const PointKind kind : {PointKind::error, PointKind::size}) {
      BasisPoint point;
      point.kind = kind;
      point.requested = kind == PointKind::error ? 0.01 : 4.0;
      point.is_achieved = result.has_plate;
      point.coefficients = 3.5;
      point.bytes = 1234;
      point.threshold_numbers = result.has_plate ? 3.0 : -1.0;
      point.stack_error = {0.0101, 0.02, 0.005, std::numeric_limits<double>::quiet_NaN(), 0.03};
      PictureErrors picture;
      picture.relative_l2 = point.stack_error;
      picture.psnr_db = {40.0, 35.0, 45.0, std::numeric_limits<double>::quiet_NaN(),
                         std::numeric_limits<double>::infinity()};
      point.pictures = {picture, picture};
      result.points.push_back(point);
    }
    study.results.push_back(result);
  }
  study.left_out = {{"DCT", "the lights form no grid"}};
  BinningResult binned;
  binned.rows = 16;
  binned.pictures.resize(2);
  study.binned = {binned};
  return study;
}

TEST(StudyReport, TablesSayWhatWasNotAchievedAndLeftOut) {
  const std::string text = summary_tables(made_study());
  EXPECT_NE(text.find("Equal error: 1 % of the stack"), std::string::npos) << text;
  EXPECT_NE(text.find("Equal size: 4 numbers per pixel"), std::string::npos);
  EXPECT_NE(text.find("not achieved"), std::string::npos);
  EXPECT_NE(text.find("left out: DCT: the lights form no grid"), std::string::npos);
  EXPECT_NE(text.find("1 of 1 tiles of 128 studied (16 pixels)"), std::string::npos);
  const std::string regions = region_tables(made_study());
  EXPECT_NE(regions.find("cast shadow"), std::string::npos);
  EXPECT_EQ(regions.find("nan"), std::string::npos);
  EXPECT_NE(binning_table(made_study()).find("16 bins per side, area lights"),
            std::string::npos);
}

TEST(StudyReport, RecommendsTheSmallestThatCompressCanWrite) {
  BasisStudy study = made_study();
  BasisResult smaller = study.results[0];
  smaller.name = "cdf53";
  smaller.title = "CDF 5/3";
  smaller.points[0].bytes = 1000;
  study.results.push_back(smaller);
  BasisResult larger = study.results[0];
  larger.name = "dct";
  larger.has_plate = false;
  larger.points[0].bytes = 1300;
  study.results.push_back(larger);
  BasisResult unreached = larger;
  unreached.name = "direct";
  unreached.points[0].bytes = 10;
  unreached.points[0].is_achieved = false;
  study.results.push_back(unreached);
  const std::vector<Recommendation> found = recommendations(study);
  ASSERT_EQ(found.size(), 1U);
  EXPECT_EQ(found[0].basis, "haar");
  EXPECT_EQ(found[0].bytes, 1234U);
  EXPECT_EQ(found[0].smaller, "CDF 5/3");
  const std::string text = recommendation_text(study, "haarlight compress s", "");
  EXPECT_NE(text.find("\n  haarlight compress s --basis haar --max-error 0.01\n"),
            std::string::npos)
      << text;
  EXPECT_NE(text.find("CDF 5/3: no: it is not orthonormal"), std::string::npos);
  EXPECT_EQ(recommended_command(found[0], "c", "p.hlb"),
            "c --basis haar --plate p.hlb --max-error 0.01");
  study.results.erase(study.results.begin());
  EXPECT_EQ(recommended_command(recommendations(study).front(), "c", "p.hlb"),
            "c --basis dct --plate none --max-error 0.01");
}

TEST(StudyReport, JsonHoldsEveryFigureAndNoNan) {
  const auto json = nlohmann::json::parse(study_json(made_study(), "made"));
  EXPECT_EQ(json["bases"].size(), 2U);
  const auto& point = json["bases"][0]["points"][0];
  EXPECT_EQ(point["bytes"], 1234);
  EXPECT_TRUE(point["stack_relative_l2"]["attached shadow"].is_null());
  EXPECT_EQ(point["pictures"]["smooth"]["psnr_db"]["diffuse"], 45.0);
  EXPECT_TRUE(json["bases"][1]["points"][0]["bare_threshold_numbers_per_pixel"].is_null());
  EXPECT_EQ(json["left_out"][0]["basis"], "DCT");
  EXPECT_EQ(json["fewer_lights"][0]["bins_a_side"], 16);
}

TEST(StudyReport, RecordsHaveTheSharedForm) {
  const auto records =
      nlohmann::json::parse(tradeoff_json(study_records(made_study(), "a command", 2)));
  // Each point: the stack, and each of 2 pictures whole and in 3 regions that have pixels.
  EXPECT_EQ(records.size(), 4U * (1 + 2 * (1 + 3)));
  for (const auto& record : records) {
    for (const char* key :
         {"algorithm", "mode", "error_norm", "error", "seconds", "bytes", "conditions"}) {
      EXPECT_TRUE(record.contains(key));
    }
    EXPECT_EQ(record.size(), 7U);
    for (const char* key : {"machine", "processors", "load", "threads", "repeats", "command"}) {
      EXPECT_TRUE(record["conditions"].contains(key));
    }
    EXPECT_EQ(record["conditions"]["bytes_are"], "compressed size, tables and gains too");
    EXPECT_TRUE(record["error"].is_number());
  }
}

TEST(StudyReport, ErrorAtBytesIsAStraightLineInLogarithms) {
  BasisResult result;
  for (const auto& [bytes, error] : {std::pair{1600U, 0.01}, std::pair{100U, 0.04}}) {
    BasisPoint point;
    point.bytes = bytes;
    point.stack_error[0] = error;
    result.points.push_back(point);
  }
  EXPECT_NEAR(error_at_bytes(result, 40.0, 10), 0.02, 1e-12);  // a power of -1/2
  EXPECT_NEAR(error_at_bytes(result, 160.0, 10), 0.01, 1e-12);
  EXPECT_TRUE(std::isnan(error_at_bytes(result, 9.0, 10)));
  EXPECT_TRUE(std::isnan(error_at_bytes({}, 9.0, 10)));
}

TEST(StudyReport, FiguresAreWholeSvg) {
  const auto figures = study_figures(made_study());
  ASSERT_EQ(figures.size(), 4U);
  for (const StudyFigure& figure : figures) {
    EXPECT_TRUE(figure.svg.starts_with("<svg "));
    EXPECT_TRUE(figure.svg.ends_with("</svg>\n"));
    EXPECT_EQ(figure.svg.find("nan"), std::string::npos);
    EXPECT_EQ(figure.svg.find("inf"), std::string::npos);
  }
}

TEST(LogPlot, PutsDecadesAtEqualDistances) {
  const std::string svg = draw_panels(
      "t", {{"panel", "x", "y", {{"a", {{1.0, 1.0}, {10.0, 0.1}, {100.0, 0.01}}, 0, false}}}},
      1);
  // The line's points: one path with three points, equally far apart.
  const std::size_t at = svg.find("fill='none' stroke='#0072b2'");
  ASSERT_NE(at, std::string::npos);
  const std::size_t path = svg.rfind("d='M", at);
  double x[3];
  double y[3];
  ASSERT_EQ(std::sscanf(svg.c_str() + path, "d='M%lf %lfL%lf %lfL%lf %lf", &x[0], &y[0], &x[1],
                        &y[1], &x[2], &y[2]),
            6);
  EXPECT_NEAR(x[2] - x[1], x[1] - x[0], 0.11);  // written to 0.1
  EXPECT_NEAR(y[2] - y[1], y[1] - y[0], 0.11);
  EXPECT_GT(x[1], x[0]);
  EXPECT_GT(y[1], y[0]);  // down the page: smaller
}

TEST(LogPlot, LeavesOutWhatHasNoLogarithmAndEscapesNames) {
  const std::string svg = draw_panels(
      "a < b", {{"none", "x", "y", {{"zero & co", {{0.0, 1.0}, {1.0, -1.0}}, 0, true}}}}, 2);
  EXPECT_NE(svg.find("nothing to show"), std::string::npos);
  EXPECT_NE(svg.find("a &lt; b"), std::string::npos);
  EXPECT_NE(svg.find("zero &amp; co"), std::string::npos);
}

}  // namespace
}  // namespace haarlight::relight
