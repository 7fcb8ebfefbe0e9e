// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/reflectance/formats/refit.h"

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/reflectance/formats/reflectance_file.h"
#include "tests/relight/reflectance/formats/quantise_model.h"
#include "tests/relight/reflectance/formats/reflectance_truth.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

using testing::empty_model;
using testing::psnr_db;
using testing::smooth_coefficients;
using testing::spread_directions;

ReflectanceModel made(ReflectanceBasis basis, ReflectanceColour colour, int n_terms) {
  ReflectanceModel model = empty_model(basis, colour, n_terms);
  quantise(model, smooth_coefficients(12, 20, n_planes_of(colour, n_terms)).view());
  return model;
}

/// The same basis holds the same pictures: only bytes are lost.
TEST(Refit, LuminanceTimesColourIsExactInRgb) {
  const ReflectanceModel lrgb = made(ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6);
  const ReflectanceModel rgb =
      refit(lrgb, {.basis = ReflectanceBasis::ptm, .n_terms = 6}, spread_over_hemisphere(50));
  EXPECT_GT(compare_pictures(lrgb, rgb, spread_over_hemisphere(9, 1.0)).worst_db, 50.0);
}

TEST(Refit, MoreTermsHoldFewer) {
  const ReflectanceModel four = made(ReflectanceBasis::hsh, ReflectanceColour::rgb, 4);
  const ReflectanceModel nine =
      refit(four, {.basis = ReflectanceBasis::hsh, .n_terms = 9}, refit_directions(four, 9));
  const auto difference = compare_pictures(four, nine, spread_over_hemisphere(9, 1.0));
  EXPECT_TRUE(difference.is_same || difference.worst_db > 48.0) << difference.worst_db;
}

/// Every pixel's colours at the fitted directions: no other coefficients come nearer.
TEST(Refit, AnotherBasisIsTheLeastSquaresFit) {
  const ReflectanceModel ptm = made(ReflectanceBasis::ptm, ReflectanceColour::rgb, 6);
  const auto directions = spread_over_hemisphere(60);
  const RefitTarget target{.basis = ReflectanceBasis::hsh, .n_terms = 4};
  const ReflectanceModel hsh = refit(ptm, target, directions);
  const auto squares = [&](const ReflectanceModel& model) {
    double sum = 0.0;
    for (const Eigen::Vector3d& direction : directions) {
      const Image<float> a = relit(ptm, direction);
      const Image<float> b = relit(model, direction);
      for (std::size_t i = 0; i < a.pixels().size(); ++i) {
        const double difference = static_cast<double>(a.pixels()[i]) - b.pixels()[i];
        sum += difference * difference;
      }
    }
    return sum;
  };
  const double best = squares(hsh);
  for (std::size_t p = 0; p < hsh.scales.size(); ++p) {
    for (const double step : {-3.0, 3.0}) {  // of bytes: more than rounding
      ReflectanceModel moved = hsh;
      moved.scales[p].offset += step * moved.scales[p].scale;
      EXPECT_GT(squares(moved), best) << p;
    }
  }
}

TEST(Refit, LinearColoursAreCoded) {
  ReflectanceModel linear = made(ReflectanceBasis::hsh, ReflectanceColour::rgb, 4);
  linear.transfer = Transfer::linear;
  const ReflectanceModel coded = refit(linear, {.basis = ReflectanceBasis::hsh, .n_terms = 16},
                                       spread_over_hemisphere(200));
  EXPECT_EQ(coded.transfer, Transfer::srgb);
  const Eigen::Vector3d at = Eigen::Vector3d(0.2, 0.1, 0.9).normalized();
  Image<float> truth = relit(linear, at);
  for (float& value : truth.pixels()) {
    value = srgb_from_linear(std::max(value, 0.0F));
  }
  EXPECT_GT(psnr_db(relit(coded, at).view(), truth.view()), 30.0);
}

TEST(Refit, TooFewDirectionsAreSaid) {
  const ReflectanceModel ptm = made(ReflectanceBasis::ptm, ReflectanceColour::rgb, 6);
  EXPECT_THROW((void)refit(ptm, {.basis = ReflectanceBasis::hsh, .n_terms = 9},
                           spread_over_hemisphere(8)),
               Error);
}

TEST(ReflectanceFile, FormatsAreToldByContentAndByName) {
  const testing::TemporaryFolder folder;
  const ReflectanceModel model = made(ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6);
  write_reflectance(folder / "a.ptm", model);
  write_reflectance(folder / "web", model);
  std::filesystem::rename(folder / "a.ptm", folder / "a.dat");
  EXPECT_EQ(recognise_reflectance(folder / "a.dat"), ReflectanceFormat::ptm);
  EXPECT_EQ(recognise_reflectance(folder / "web"), ReflectanceFormat::web);
  EXPECT_EQ(recognise_reflectance(folder.path()), std::nullopt);
  EXPECT_THROW((void)read_reflectance(folder.path()), Error);
  EXPECT_THROW((void)read_reflectance(folder / "absent"), Error);
  EXPECT_THROW((void)reflectance_format_of_name("a.png"), Error);
  EXPECT_EQ(reflectance_format_of_name("A.RTI"), ReflectanceFormat::rti);
  for (const Eigen::Vector3d& direction : spread_directions(3)) {
    EXPECT_GT(psnr_db(relit(read_reflectance(folder / "a.dat"), direction).view(),
                      relit(model, direction).view()),
              45.0);
  }
}

TEST(ReflectanceFile, PlanesBeyondTheMemoryAreRefused) {
  const testing::TemporaryFolder folder;
  const ReflectanceModel ptm = made(ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6);
  const ReflectanceModel hsh = made(ReflectanceBasis::hsh, ReflectanceColour::rgb, 9);
  write_reflectance(folder / "plain.ptm", ptm);
  write_reflectance(folder / "jpeg.ptm", ptm, {.is_jpeg = true});
  write_reflectance(folder / "a.rti", hsh);
  write_reflectance(folder / "web", hsh);
  for (const char* name : {"plain.ptm", "jpeg.ptm", "a.rti", "web"}) {
    const std::size_t bytes = read_reflectance(folder / name).planes.pixels().size();
    EXPECT_NO_THROW((void)read_reflectance(folder / name, {.most_bytes = bytes})) << name;
    try {
      (void)read_reflectance(folder / name, {.most_bytes = bytes - 1});
      ADD_FAILURE() << name;
    } catch (const Error& error) {
      EXPECT_NE(std::string(error.what()).find("--memory"), std::string::npos) << error.what();
      EXPECT_NE(std::string(error.what()).find(name), std::string::npos) << error.what();
    }
  }
}

}  // namespace
}  // namespace haarlight::relight
