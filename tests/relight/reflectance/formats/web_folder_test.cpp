// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/reflectance/formats/web_folder.h"

#include <cmath>
#include <map>
#include <string>

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "core/picture/jpeg.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/reflectance/formats/quantise.h"
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

ReflectanceModel pca_model(ReflectanceBasis basis, int n_planes) {
  ReflectanceModel model = empty_model(basis, ReflectanceColour::pca, n_planes);
  model.resolution = basis == ReflectanceBasis::bilinear ? 5 : 0;
  if (basis == ReflectanceBasis::rbf) {
    model.lights = spread_directions(25);
    model.rbf_sigma = 0.2;
  }
  model.axes.resize(n_planes + 1, 75);
  for (Eigen::Index p = 0; p <= n_planes; ++p) {
    for (Eigen::Index i = 0; i < 75; ++i) {
      model.axes(p, i) = p == 0 ? 0.5F + 0.3F * std::sin(0.2F * static_cast<float>(i))
                                : 0.4F * std::cos(0.3F * static_cast<float>(p * i + 2 * p));
    }
  }
  quantise(model, smooth_coefficients(16, 24, n_planes).view());
  return model;
}

ReflectanceModel fixed_model(ReflectanceBasis basis, ReflectanceColour colour, int n_terms) {
  ReflectanceModel model = empty_model(basis, colour, n_terms);
  quantise(model, smooth_coefficients(16, 24, n_planes_of(colour, n_terms)).view());
  return model;
}

double worst_psnr(const ReflectanceModel& found, const ReflectanceModel& truth) {
  double worst = 200.0;
  for (const Eigen::Vector3d& direction : spread_directions(9)) {
    worst = std::min(worst,
                     psnr_db(relit(found, direction).view(), relit(truth, direction).view()));
  }
  return worst;
}

TEST(WebFolder, EveryKindComesBack) {
  struct Case {
    const char* name;
    ReflectanceModel model;
  };
  for (const Case& c :
       {Case{"ptm", fixed_model(ReflectanceBasis::ptm, ReflectanceColour::rgb, 6)},
        Case{"lrgb", fixed_model(ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6)},
        Case{"hsh4", fixed_model(ReflectanceBasis::hsh, ReflectanceColour::rgb, 4)},
        Case{"hsh9", fixed_model(ReflectanceBasis::hsh, ReflectanceColour::rgb, 9)},
        Case{"hsh9l", fixed_model(ReflectanceBasis::hsh, ReflectanceColour::lrgb, 9)},
        Case{"bilinear", pca_model(ReflectanceBasis::bilinear, 9)},
        Case{"padded", pca_model(ReflectanceBasis::bilinear, 7)}}) {
    const TemporaryFolder folder;
    ReflectanceModel model = c.model;
    model.photographed.model = "CamX";
    model.photographed.f_number = 8.0;
    write_web_folder(folder / "web", model, {.quality = 100});
    const ReflectanceModel found = read_web_folder(folder / "web");
    EXPECT_EQ(found.photographed, model.photographed);
    EXPECT_EQ(found.basis, c.model.basis);
    EXPECT_EQ(found.colour, c.model.colour);
    // Quality 100 moves a plane by about a byte; axes by half a byte of their range.
    const double db = worst_psnr(found, c.model);
    std::printf("%s: %.1f dB\n", c.name, db);
    EXPECT_GT(db, 42.0) << c.name;
  }
}

/// What OpenLIME 1.2.6 puts on a black page where a picture's opacity is `alpha`: codes become
/// light by a power of 2.2, are blended there, and are coded again.
float shown_on_black(float code, double alpha) {
  const double light = std::pow(std::max(static_cast<double>(code), 0.0), 2.2);
  return static_cast<float>(std::pow(light * std::clamp(alpha, 0.0, 1.0), 1.0 / 2.2));
}

/// Its shader gives (luminance * colour, luminance), the last taken as opacity.
TEST(WebFolder, ALuminanceIsOpaqueInOpenLime) {
  const ReflectanceModel model = fixed_model(ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6);
  const TemporaryFolder folder;
  write_web_folder(folder / "web", model, {.quality = 100});
  const auto info = nlohmann::json::parse(read_file(folder / "web/info.json", 1U << 20U));
  const auto& scale = info["materials"][0]["scale"];
  for (std::size_t c = 0; c < 3; ++c) {  // how much larger the file's luminance is
    EXPECT_NEAR(scale[c].get<double>() * kWebLuminance, 255.0 * model.scales[6 + c].scale,
                1e-12);
  }
  const ReflectanceModel found = read_web_folder(folder / "web");
  ReflectanceModel luminance = found;  // with colours of 1: the luminance alone
  for (std::size_t c = 6; c < 9; ++c) {
    luminance.scales[c] = {0.0, 1.0};
  }
  const double raised = 1.0 / (scale[0].get<double>() / (255.0 * found.scales[6].scale));
  for (const Eigen::Vector3d& direction : spread_directions(9)) {
    const Image<float> truth = relit(found, direction);
    const Image<float> l = relit(luminance, direction);
    Image<float> shown = truth;
    for (int y = 0; y < shown.height(); ++y) {
      for (int x = 0; x < shown.width(); ++x) {
        for (int c = 0; c < 3; ++c) {
          shown(y, x, c) = shown_on_black(truth(y, x, c), raised * l(y, x, 0));
        }
      }
    }
    // 2.2 and back is rounding; without the factor a middle grey loses a quarter: 12 dB.
    EXPECT_GT(psnr_db(shown.view(), truth.view()), 80.0);
  }
}

TEST(WebFolder, ALuminanceGoesToPtmAndBackWithItsBytes) {
  ReflectanceModel model = empty_model(ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6);
  quantise(model, smooth_coefficients(16, 24, 9).view(), ScaleRule::ptm);
  const TemporaryFolder folder;
  write_web_folder(folder / "web", model, {.quality = 100});
  const ReflectanceModel read = read_web_folder(folder / "web");
  const ReflectanceModel found = with_scales_of(ScaleRule::ptm, read);
  for (int y = 0; y < 16; ++y) {
    for (int x = 0; x < 24; ++x) {
      for (int p = 6; p < 9; ++p) {
        EXPECT_EQ(found.planes(y, x, p), read.planes(y, x, p));
      }
    }
  }
  EXPECT_GT(worst_psnr(found, model), 42.0);
}

TEST(WebFolder, RadialFunctionsAreNotWritten) {
  const TemporaryFolder folder;
  try {
    write_web_folder(folder / "web", pca_model(ReflectanceBasis::rbf, 6));
    FAIL() << "written";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("bilinear"), std::string::npos) << error.what();
  }
  EXPECT_FALSE(std::filesystem::exists(folder / "web"));
}

/// OpenLIME 1.2.6: no lower than 0.15 radians.
TEST(WebFolder, HarmonicsStopAboveTheHorizon) {
  const TemporaryFolder folder;
  write_web_folder(folder / "web",
                   fixed_model(ReflectanceBasis::hsh, ReflectanceColour::rgb, 9));
  const ReflectanceModel model = read_web_folder(folder / "web");
  const auto at = [&](double elevation) {
    return relit(model,
                 {-0.6 * std::cos(elevation), 0.8 * std::cos(elevation), std::sin(elevation)});
  };
  const Image<float> lowest = at(0.15);
  for (const double elevation : {0.1, 0.0, -0.5}) {
    EXPECT_GT(psnr_db(at(elevation).view(), lowest.view()), 100.0) << elevation;
  }
  EXPECT_LT(psnr_db(at(0.25).view(), lowest.view()), 60.0);
}

/// Pictures of one colour each, one pixel, as a folder's files.
class OnePixel {
 public:
  void add(int r, int g, int b) {
    const std::array<int, 3> colour{r, g, b};
    files_[fmt::format("plane_{}.jpg", files_.size())] = encode_jpeg(
        {1, 1}, JpegQuality{.quality = 100}, "test", [&](int, std::span<std::uint8_t> samples) {
          for (std::size_t c = 0; c < 3; ++c) {
            samples[c] = static_cast<std::uint8_t>(colour[c]);
          }
        });
  }
  [[nodiscard]] ReflectanceModel read(const std::string& info) const {
    return parse_web_folder(
        info, [this](const std::string& name) { return files_.at(name); }, "test");
  }

 private:
  std::map<std::string, std::string> files_;
};

constexpr double kByte = 2.0 / 255.0;  // what YCbCr and back may move a byte by

TEST(WebFolder, TermsStandInRelightsOrder) {
  OnePixel files;
  files.add(10, 20, 30);  // 1
  files.add(40, 50, 60);  // u
  files.add(70, 80, 90);  // v
  files.add(15, 25, 35);  // u^2
  files.add(45, 55, 65);  // uv
  files.add(75, 85, 95);  // v^2
  std::string scale = "1";
  std::string bias = "0";
  for (int i = 1; i < 18; ++i) {
    scale += i == 4 ? ",3" : ",1";  // u of G
    bias += i == 4 ? ",0.1" : ",0";
  }
  const ReflectanceModel model = files.read(fmt::format(
      R"({{"width":1,"height":1,"format":"jpg","type":"ptm","colorspace":"rgb","nplanes":18,
          "materials":[{{"scale":[{}],"bias":[{}]}}]}})",
      scale, bias));
  const double u = 0.5;
  const double v = -0.3;
  const Image<float> picture = relit(model, {u, v, std::sqrt(1.0 - u * u - v * v)});
  const auto red = 10 + 40 * u + 70 * v + 15 * u * u + 45 * u * v + 75 * v * v;
  EXPECT_NEAR(picture(0, 0, 0), red / 255.0, 3 * kByte);
  const auto green = 20 / 255.0 + 3.0 * (50 / 255.0 - 0.1) * u +
                     (80 * v + 25 * u * u + 55 * u * v + 85 * v * v) / 255.0;
  EXPECT_NEAR(picture(0, 0, 1), green, 5 * kByte);
}

/// A grid of 2 x 2 nodes: at the zenith each counts a quarter.
constexpr const char* kGrid =
    R"("width":1,"height":1,"type":"bilinear","resolution":2,"nplanes":3,
       "materials":[{"scale":[2,1,1],"bias":[0.5,0,0],"range":[127,254,127]}])";

TEST(WebFolder, AxesOfMrgbAreWeightedColours) {
  OnePixel files;
  files.add(255, 51, 0);
  const std::string basis =
      "51,51,51, 51,51,51, 51,51,51, 51,51,51,"              // mean 0.2
      "254,127,127, 127,127,127, 127,127,127, 127,127,127,"  // red 1 at node 0
      "127,254,127, 127,254,127, 127,254,127, 127,254,127,"  // green 0.5 everywhere
      "127,127,127, 127,127,127, 127,127,127, 127,127,127";
  const ReflectanceModel model =
      files.read(fmt::format(R"({{{},"colorspace":"mrgb","basis":[{}]}})", kGrid, basis));
  // Coefficients: (1 - 0.5) * 2 = 1; 0.2; 0.
  const Image<float> zenith = relit(model, {0, 0, 1});
  EXPECT_NEAR(zenith(0, 0, 0), 0.2 + 0.25, 2 * kByte);
  EXPECT_NEAR(zenith(0, 0, 1), 0.2 + 0.5 * 0.2, kByte);
  EXPECT_NEAR(zenith(0, 0, 2), 0.2, kByte);
  // Node 0: the corner of x + y = -1, y - x = -1, which is light from -y.
  const Image<float> corner = relit(model, {0, -1, 0});
  EXPECT_NEAR(corner(0, 0, 0), 1.2, 2 * kByte);
  const Image<float> other = relit(model, {0, 1, 0});
  EXPECT_NEAR(other(0, 0, 0), 0.2, kByte);
}

TEST(WebFolder, AxesOfMyccAreLumaAndChroma) {
  OnePixel files;
  files.add(255, 255, 255);
  std::string basis;
  for (int row = 0; row < 4; ++row) {
    for (int node = 0; node < 4; ++node) {
      basis +=
          row == 0 ? "102,0,0," : fmt::format("{},{},{},", 127 + 10 * row, 127 + 50, 127 + 25);
    }
  }
  basis.pop_back();
  const ReflectanceModel model = files.read(fmt::format(
      R"({{"width":1,"height":1,"type":"bilinear","resolution":2,"yccplanes":[1,1,1],
          "colorspace":"mycc","basis":[{}],
          "materials":[{{"scale":[1,1,1],"bias":[0,0,0],"range":[100,100,100]}}]}})",
      basis));
  // Y = 0.4 + 0.1, Cb = 0.5 (its row's second number), Cr = 0.25 (its row's third).
  const double y = 0.5;
  const double cb = 0.5;
  const double cr = 0.25;
  const Image<float> picture = relit(model, {0, 0, 1});
  EXPECT_NEAR(picture(0, 0, 1), y + cr / 2, kByte);
  EXPECT_NEAR(picture(0, 0, 2), y - cr / 2 - cb / 2, kByte);
  EXPECT_NEAR(picture(0, 0, 0), y - cr / 2 - cb / 2 + cb, kByte);
}

/// At a light far from the others only that light's colours count.
TEST(WebFolder, RadialFunctionsSumToOne) {
  const ReflectanceModel model = pca_model(ReflectanceBasis::rbf, 6);
  for (const Eigen::Vector3d& direction : spread_directions(40, -0.5)) {
    double sum = 0.0;
    for (const NodeWeight& weight : node_weights(model, direction)) {
      sum += weight.weight;
    }
    EXPECT_NEAR(sum, 1.0, 1e-12);
  }
  // Without a sigma OpenLIME's rule. From lights 0, 1 and 2 away: m = (e^-2 + 2 e^-4) /
  // (1 + e^-2 + e^-4).
  ReflectanceModel adaptive = model;
  adaptive.rbf_sigma = 0.0;
  adaptive.lights = {{0, 0, 1}, {0, 1, 1}, {0, 0, -1}};
  const double m =
      (std::exp(-2.0) + 2.0 * std::exp(-4.0)) / (1.0 + std::exp(-2.0) + std::exp(-4.0));
  const double sum = 1.0 + std::exp(-8.0 / m) + std::exp(-32.0 / m);
  const auto three = node_weights(adaptive, {0, 0, 1});
  ASSERT_EQ(three.size(), 3U);
  EXPECT_NEAR(three[0].weight, 1.0 / sum, 1e-12);
  EXPECT_NEAR(three[1].weight, std::exp(-8.0 / m) / sum, 1e-12);
  adaptive.lights = {{0, 0, 1}};
  EXPECT_EQ(node_weights(adaptive, {0, 0, 1})[0].weight, 1.0);
  ReflectanceModel narrow = model;
  narrow.rbf_sigma = 1e-3;  // all underflow but one
  const auto weights = node_weights(narrow, narrow.lights[3]);
  ASSERT_EQ(weights.size(), 1U);
  EXPECT_EQ(weights[0].node, 3);
}

TEST(WebFolder, WhatCannotBeReadIsRefusedByItsField) {
  OnePixel files;
  files.add(1, 2, 3);
  std::string basis = "\"basis\":[0";
  for (int i = 1; i < 48; ++i) {
    basis += ",0";
  }
  basis += "]";
  const std::string good = fmt::format(R"({{{},"colorspace":"mrgb",{}}})", kGrid, basis);
  ASSERT_NO_THROW((void)files.read(good));
  const auto refusal = [&](const std::string& from, const std::string& to) -> std::string {
    std::string info = good;
    info.replace(info.find(from), from.size(), to);
    try {
      (void)files.read(info);
    } catch (const Error& error) {
      return error.what();
    }
    return "taken";
  };
  struct Case {
    const char* from;
    const char* to;
    const char* expected;
  };
  for (const Case& c : {Case{"\"width\":1", "\"width\":0", "width"},
                        Case{"\"width\":1", "\"width\":2", "plane_0.jpg"},
                        Case{"\"width\":1", "\"width\":65000", "plane_0.jpg"},
                        Case{"\"width\":1", "\"width\":1e300", "width"},
                        Case{"\"type\":\"bilinear\"", "\"type\":\"sh\"", "type"},
                        Case{"\"type\":\"bilinear\"", "\"type\":\"ptm\"", "colorspace"},
                        Case{"\"resolution\":2", "\"resolution\":3", "basis"},
                        Case{"\"resolution\":2", "\"resolution\":1", "resolution"},
                        Case{"\"nplanes\":3", "\"nplanes\":6", "scale"},
                        Case{"\"nplanes\":3", "\"nplanes\":3000000", "nplanes"},
                        Case{"\"scale\":[2,1,1]", "\"scale\":[2,1]", "scale"},
                        Case{"\"scale\":[2,1,1]", "\"scale\":[2,1,null]", "scale"},
                        Case{"\"range\":[127,", "\"range\":[0,", "range"},
                        Case{"\"materials\":[", "\"materials\":[{},", "materials"},
                        Case{"[0,0", "[0,256", "basis"}, Case{"{", "", "JSON"}}) {
    EXPECT_NE(refusal(c.from, c.to).find(c.expected), std::string::npos)
        << c.to << ": " << refusal(c.from, c.to);
  }
}

TEST(WebFolder, AMissingPictureIsNamed) {
  const TemporaryFolder folder;
  write_web_folder(folder / "web",
                   fixed_model(ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6));
  std::filesystem::remove(folder / "web/plane_2.jpg");
  try {
    (void)read_web_folder(folder / "web");
    FAIL() << "read without plane_2.jpg";
  } catch (const Error& error) {
    EXPECT_NE(error.where().find("plane_2.jpg"), std::string::npos);
  }
}

}  // namespace
}  // namespace haarlight::relight
