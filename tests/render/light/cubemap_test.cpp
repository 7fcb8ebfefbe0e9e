// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/light/cubemap.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <numbers>

#include <Eigen/Geometry>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/render/light/environment_texels.h"
#include "tests/temporary_folder.h"

namespace haarlight::render {
namespace {

constexpr double kPi = std::numbers::pi;

Image<float> picture_with_texel(int width, int height, int x, int y, float value = 1.0F) {
  Image<float> image(height, width, 1);
  image(y, x) = value;
  return image;
}

/// The direction of the only bright texel, by what the integration sees.
Eigen::Vector3d bright_direction(const Environment& environment) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  const EnvironmentTexels texels(environment);
  for (int row = 0; row < texels.n_rows(); ++row) {
    texels.for_each(row, [&](const EnvironmentTexel& texel) {
      sum += texel.solid_angle * texel.radiance[0] * texel.centre;
    });
  }
  return sum.normalized();
}

double angle_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

TEST(Environment, LatLongFollowsTheConventionsPage) {
  // 8 x 4: columns of 45 degrees. The middle is +x, u grows towards -y, v from +z down.
  struct Case {
    int x;
    int y;
    double theta;
    double phi;
  };
  for (const Case& c :
       {Case{3, 1, 1.5, 0.125}, Case{4, 1, 1.5, -0.125}, Case{5, 2, 2.5, -0.375},
        Case{0, 0, 0.5, 0.875}, Case{7, 3, 3.5, -0.875}}) {
    const double theta = kPi * c.theta / 4.0;
    const double phi = kPi * c.phi;
    const Eigen::Vector3d expected(std::sin(theta) * std::cos(phi),
                                   std::sin(theta) * std::sin(phi), std::cos(theta));
    const auto environment =
        Environment::from_picture(picture_with_texel(8, 4, c.x, c.y), "made");
    EXPECT_EQ(environment.layout(), EnvironmentLayout::lat_long);
    EXPECT_LT(angle_between(bright_direction(environment), expected), 0.15);
    EXPECT_EQ(environment.radiance(expected)[0], 1.0);
    EXPECT_EQ(environment.radiance(-expected)[0], 0.0);
  }
}

/// Centres of the faces in the world: GL's +y is up, GL's +z is our -y.
const std::array<Eigen::Vector3d, 6> kFaceCentres = {
    Eigen::Vector3d{1, 0, 0}, {-1, 0, 0}, {0, 0, 1}, {0, 0, -1}, {0, -1, 0}, {0, 1, 0}};

/// Where GL puts the texel right of the middle and the one above it, in the world.
const std::array<Eigen::Vector3d, 6> kFaceRight = {
    Eigen::Vector3d{0, 1, 0}, {0, -1, 0}, {1, 0, 0}, {1, 0, 0}, {1, 0, 0}, {-1, 0, 0}};
const std::array<Eigen::Vector3d, 6> kFaceUp = {
    Eigen::Vector3d{0, 0, 1}, {0, 0, 1}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, 1}};

TEST(Environment, OneBrightTexelAFacePinsTheStrip) {
  for (int f = 0; f < 6; ++f) {
    const auto i = static_cast<std::size_t>(f);
    const auto middle =
        Environment::from_picture(picture_with_texel(18, 3, 3 * f + 1, 1), "made");
    EXPECT_EQ(middle.layout(), EnvironmentLayout::strip);
    EXPECT_LT(angle_between(bright_direction(middle), kFaceCentres[i]), 1e-9) << f;
    const auto right =
        Environment::from_picture(picture_with_texel(18, 3, 3 * f + 2, 1), "made");
    EXPECT_GT(bright_direction(right).dot(kFaceRight[i]), 0.4) << f;
    EXPECT_GT(right.radiance(kFaceCentres[i] + 0.7 * kFaceRight[i])[0], 0.9) << f;
    const auto up = Environment::from_picture(picture_with_texel(18, 3, 3 * f + 1, 0), "made");
    EXPECT_GT(bright_direction(up).dot(kFaceUp[i]), 0.4) << f;
    EXPECT_GT(up.radiance(kFaceCentres[i] + 0.7 * kFaceUp[i])[0], 0.9) << f;
  }
}

TEST(Environment, CrossesHoldTheFacesOfTheStrip) {
  // Cells (column, row) of +x -x +y -y +z -z.
  const std::array<std::array<int, 2>, 6> horizontal = {
      {{2, 1}, {0, 1}, {1, 0}, {1, 2}, {1, 1}, {3, 1}}};
  for (int f = 0; f < 6; ++f) {
    const auto i = static_cast<std::size_t>(f);
    // The texel right of the middle and above it.
    const auto strip =
        Environment::from_picture(picture_with_texel(30, 5, 5 * f + 3, 1), "made");
    const auto cross = Environment::from_picture(
        picture_with_texel(20, 15, 5 * horizontal[i][0] + 3, 5 * horizontal[i][1] + 1), "made");
    EXPECT_EQ(cross.layout(), EnvironmentLayout::horizontal_cross);
    EXPECT_LT(angle_between(bright_direction(cross), bright_direction(strip)), 1e-12) << f;
    // In the vertical cross -z stands on its head below -y.
    const std::array<int, 2> cell = f == 5 ? std::array<int, 2>{1, 3} : horizontal[i];
    const int x = f == 5 ? 1 : 3;
    const int y = f == 5 ? 3 : 1;
    const auto vertical = Environment::from_picture(
        picture_with_texel(15, 20, 5 * cell[0] + x, 5 * cell[1] + y), "made");
    EXPECT_EQ(vertical.layout(), EnvironmentLayout::vertical_cross);
    EXPECT_LT(angle_between(bright_direction(vertical), bright_direction(strip)), 1e-12) << f;
  }
}

TEST(Environment, NeighboursOfACrossTouchInTheWorld) {
  // Across the seam between +z and +x of the horizontal cross the direction moves by one texel.
  const int n = 16;
  const auto left =
      Environment::from_picture(picture_with_texel(4 * n, 3 * n, 2 * n - 1, n + 3), "");
  const auto right =
      Environment::from_picture(picture_with_texel(4 * n, 3 * n, 2 * n, n + 3), "");
  EXPECT_LT(angle_between(bright_direction(left), bright_direction(right)), 2.5 / n);
  const auto above =
      Environment::from_picture(picture_with_texel(4 * n, 3 * n, n + 3, n - 1), "");
  const auto below = Environment::from_picture(picture_with_texel(4 * n, 3 * n, n + 3, n), "");
  EXPECT_LT(angle_between(bright_direction(above), bright_direction(below)), 2.5 / n);
  const auto low =
      Environment::from_picture(picture_with_texel(4 * n, 3 * n, n + 3, 2 * n), "");
  const auto middle =
      Environment::from_picture(picture_with_texel(4 * n, 3 * n, n + 3, 2 * n - 1), "");
  EXPECT_LT(angle_between(bright_direction(low), bright_direction(middle)), 2.5 / n);
  // The vertical cross: -z below -y.
  const auto down =
      Environment::from_picture(picture_with_texel(3 * n, 4 * n, n + 3, 3 * n - 1), "");
  const auto back =
      Environment::from_picture(picture_with_texel(3 * n, 4 * n, n + 3, 3 * n), "");
  EXPECT_LT(angle_between(bright_direction(down), bright_direction(back)), 2.5 / n);
}

TEST(Environment, TexelsCoverTheSphereOnce) {
  for (const auto& [w, h] :
       {std::pair{2, 1}, {16, 8}, {128, 64}, {6, 1}, {24, 18}, {96, 128}}) {
    const auto environment = Environment::from_picture(Image<float>(h, w, 3), "made");
    double exact = 0.0;
    double polygons = 0.0;
    const EnvironmentTexels texels(environment);
    for (int row = 0; row < texels.n_rows(); ++row) {
      texels.for_each(row, [&](const EnvironmentTexel& texel) {
        exact += texel.solid_angle;
        polygons += solid_angle(texel.corners);
        EXPECT_GT(texel.solid_angle, 0.0);
      });
    }
    EXPECT_NEAR(exact, 4.0 * kPi, 1e-12 * w * h);
    EXPECT_NEAR(polygons, 4.0 * kPi, 1e-11 * w * h);
  }
}

TEST(EnvironmentTexels, ThoseNotWantedHaveNoCornersAndAllElseTheSame) {
  for (const auto& [w, h] : {std::pair{2, 1}, {64, 32}, {1024, 512}, {24, 18}}) {
    auto turned = Environment::from_picture(Image<float>(h, w, 1), "made");
    const EnvironmentTexels some(turned, 0.3);
    auto copy = turned;
    copy.rotate(0.3);
    const EnvironmentTexels all(copy);
    std::vector<EnvironmentTexel> texels;
    std::size_t i = 0;
    for (int row = 0; row < all.n_rows(); row += 1 + h / 9) {
      texels.clear();
      i = 0;
      all.for_each(row, [&](const EnvironmentTexel& texel) { texels.push_back(texel); });
      some.for_each(
          row, [](const Eigen::Vector3d& centre) { return centre.x() > 0.2; },
          [&](const EnvironmentTexel& texel) {
            const EnvironmentTexel& whole = texels.at(i++);
            ASSERT_EQ(texel.centre, whole.centre);
            ASSERT_EQ(texel.solid_angle, whole.solid_angle);
            ASSERT_LE(whole.radius, all.most_radius());
            ASSERT_EQ(texel.corners,
                      texel.centre.x() > 0.2 ? whole.corners : DirectionPolygon());
          });
      ASSERT_EQ(i, texels.size());
    }
  }
}

TEST(Environment, RotationIsCounterClockwiseAboutZ) {
  auto environment = Environment::from_picture(picture_with_texel(360, 180, 180, 90), "made");
  const Eigen::Vector3d before = bright_direction(environment);
  EXPECT_GT(before.x(), 0.99);
  environment.rotate(0.5 * kPi);
  EXPECT_GT(bright_direction(environment).y(), 0.99);
  EXPECT_EQ(environment.radiance({-before.y(), before.x(), before.z()})[0], 1.0);
}

class EnvironmentFile : public ::testing::Test {
 protected:
  void expect_refused(const std::filesystem::path& path, const std::string& words) {
    try {
      (void)Environment::read(path);
      FAIL() << path << " was taken";
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), ::testing::HasSubstr(words));
      EXPECT_FALSE(error.hint().empty());
    }
  }

  testing::TemporaryFolder own_;
  std::filesystem::path folder_ = own_.path();
};

/// Integral of radiance over the sphere.
Eigen::Vector3d light_of(const Environment& environment) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  const EnvironmentTexels texels(environment);
  for (int row = 0; row < texels.n_rows(); ++row) {
    texels.for_each(
        row, [&](const EnvironmentTexel& texel) { sum += texel.solid_angle * texel.radiance; });
  }
  return sum;
}

TEST(Environment, ReducedKeepsItsLightAndItsPositions) {
  Image<float> sky(64, 128, 3);
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 128; ++x) {
      sky(y, x, 0) = static_cast<float>(1 + (x * 7 + y * 3) % 11);
      sky(y, x, 1) = x < 64 ? 4.0F : 0.0F;
      sky(y, x, 2) = y < 32 ? 2.0F : 0.0F;
    }
  }
  Environment full = Environment::from_picture(sky, "sky");
  full.rotate(0.7);
  const Environment small = full.reduced(32);
  EXPECT_EQ(small.n_rows(), 16);
  EXPECT_EQ(small.row_texels(), 32);
  // Rows are weighted by their exact solid angle; means are rounded to float.
  EXPECT_LT((light_of(small) - light_of(full)).norm(), 1e-6 * light_of(full).norm());
  for (const Eigen::Vector3d& d :
       {Eigen::Vector3d(0.3, 0.5, 0.6), Eigen::Vector3d(-0.8, 0.1, -0.4)}) {
    EXPECT_EQ(small.radiance(d).tail(2), full.radiance(d).tail(2)) << "it turns alike";
  }
  EXPECT_EQ(full.reduced(128).row_texels(), 128) << "small enough as it is";
  EXPECT_EQ(full.reduced(1000).row_texels(), 128);
}

TEST(Environment, ReducedCubesKeepTheirLightToThePermille) {
  Image<float> strip(16, 96, 1);
  for (int y = 0; y < 16; ++y) {
    for (int x = 0; x < 96; ++x) {
      strip(y, x) = static_cast<float>(1 + (x * 5 + y * y) % 13);
    }
  }
  const Environment full = Environment::from_picture(strip, "strip");
  const Environment small = full.reduced(16);
  EXPECT_EQ(small.row_texels(), 4);
  EXPECT_NEAR(light_of(small).x(), light_of(full).x(), 1e-3 * light_of(full).x());
}

TEST_F(EnvironmentFile, SixFilesAreTheStripsFaces) {
  const std::array<const char*, 6> names = {"px", "nx", "py", "ny", "pz", "nz"};
  Image<float> strip(4, 24, 3);
  for (int f = 0; f < 6; ++f) {
    Image<float> face(4, 4, 3);
    for (int y = 0; y < 4; ++y) {
      for (int x = 0; x < 4; ++x) {
        for (int c = 0; c < 3; ++c) {
          face(y, x, c) =
              static_cast<float>(f * 100 + y * 10 + x) + 0.1F * static_cast<float>(c);
          strip(y, 4 * f + x, c) = face(y, x, c);
        }
      }
    }
    write_image(folder_ / (std::string(names[static_cast<std::size_t>(f)]) + ".exr"),
                face.view());
  }
  const auto files = Environment::read(folder_);
  const auto one = Environment::from_picture(strip, "made");
  EXPECT_EQ(files.layout(), EnvironmentLayout::six_files);
  for (int i = 0; i < 200; ++i) {
    const Eigen::Vector3d d(std::sin(i * 0.7), std::cos(i * 1.3), std::sin(i * 2.1));
    EXPECT_EQ(files.radiance(d), one.radiance(d));
  }
}

TEST_F(EnvironmentFile, BrokenOnesAreRefused) {
  std::ofstream(folder_ / "text.hdr") << "this is no picture\n";
  expect_refused(folder_ / "text.hdr", "text.hdr");

  write_image(folder_ / "shape.exr", Image<float>(10, 17, 3).view());
  expect_refused(folder_ / "shape.exr", "17 x 10");

  Image<float> nan(8, 16, 3);
  nan(3, 5, 1) = std::numeric_limits<float>::quiet_NaN();
  write_image(folder_ / "nan.exr", nan.view());
  expect_refused(folder_ / "nan.exr", "nan.exr");

  Image<float> infinite(8, 16, 3);
  infinite(3, 5, 1) = std::numeric_limits<float>::infinity();
  EXPECT_THROW(write_image(folder_ / "inf.exr", infinite.view()), Error);
  EXPECT_FALSE(std::filesystem::exists(folder_ / "inf.exr"));
  EXPECT_THROW((void)Environment::from_picture(infinite, "inf"), Error);

  Image<float> bright(8, 16, 3);
  bright(3, 5, 1) = 3e38F;
  write_image(folder_ / "bright.exr", bright.view());
  expect_refused(folder_ / "bright.exr", "3e+38 at column 5, row 3");

  Image<float> negative(8, 16, 3);
  negative(7, 15, 2) = -0.5F;
  write_image(folder_ / "negative.exr", negative.view());
  expect_refused(folder_ / "negative.exr", "column 15, row 7");

  // What a filter leaves below zero is no light, and no reason to refuse a sky.
  Image<float> ringing(8, 16, 1);
  ringing(2, 3) = 50.0F;
  ringing(4, 4) = -3e-6F;
  write_image(folder_ / "ringing.exr", ringing.view());
  const auto sky = Environment::read(folder_ / "ringing.exr");
  double least = 1.0;
  const EnvironmentTexels texels(sky);
  for (int row = 0; row < texels.n_rows(); ++row) {
    texels.for_each(row, [&](const EnvironmentTexel& texel) {
      least = std::min(least, texel.radiance[0]);
    });
  }
  EXPECT_EQ(least, 0.0);

  const auto whole = folder_ / "whole.exr";
  write_image(whole, Image<float>(64, 128, 3).view());
  std::filesystem::copy_file(whole, folder_ / "cut.exr");
  std::filesystem::resize_file(folder_ / "cut.exr", std::filesystem::file_size(whole) / 2);
  expect_refused(folder_ / "cut.exr", "cut.exr");

  expect_refused(folder_ / "missing.hdr", "missing.hdr");
}

TEST_F(EnvironmentFile, BrokenFacesAreRefused) {
  const auto six = folder_ / "six";
  std::filesystem::create_directories(six);
  for (const char* name : {"px", "nx", "py", "ny", "pz"}) {
    write_image(six / (std::string(name) + ".exr"), Image<float>(4, 4, 3).view());
  }
  expect_refused(six, "no face -z");
  write_image(six / "nz.exr", Image<float>(8, 8, 3).view());
  expect_refused(six, "face -z is 8 x 8");
  write_image(six / "nz.exr", Image<float>(4, 3, 3).view());
  expect_refused(six, "face -z is 3 x 4");
}

}  // namespace
}  // namespace haarlight::render
