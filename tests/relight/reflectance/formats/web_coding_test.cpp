// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <filesystem>
#include <random>
#include <string>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/relight/reflectance/formats/refit.h"
#include "haarlight/relight/reflectance/formats/web_folder.h"
#include "relight/reflectance/formats/plane_weights.h"
#include "relight/reflectance/formats/web_target.h"
#include "tests/relight/reflectance/formats/reflectance_truth.h"

namespace haarlight::relight {
namespace {

using testing::empty_model;

constexpr int kSide = 64;

/// Planes of noise that stay off 0 and 255 by any rounding.
void fill_with_noise(ReflectanceModel& model) {
  model.planes = Image<std::uint8_t>(kSide, kSide, model.n_planes());
  std::mt19937 random(7);
  for (std::uint8_t& byte : model.planes.pixels()) {
    byte = static_cast<std::uint8_t>(40 + random() % 176);
  }
}

/// Axes of 1, 1/2, 1/4 ...: one step of the last plane moves a picture 32 times less.
ReflectanceModel fading_axes() {
  ReflectanceModel model = empty_model(ReflectanceBasis::bilinear, ReflectanceColour::pca, 6);
  model.resolution = 4;
  model.axes.resize(7, 48);
  model.scales.resize(6);
  for (Eigen::Index p = 0; p < 7; ++p) {
    for (Eigen::Index i = 0; i < 48; ++i) {
      model.axes(p, i) =
          p == 0 ? 0.5F : std::ldexp((p * i) % 5 < 2 ? 1.0F : -1.0F, 1 - static_cast<int>(p));
    }
  }
  model.scales.assign(6, {1.0 / 255.0, -0.5});
  fill_with_noise(model);
  return model;
}

ReflectanceModel noisy(ReflectanceBasis basis, ReflectanceColour colour, int n_terms) {
  ReflectanceModel model = empty_model(basis, colour, n_terms);
  const int n = n_planes_of(colour, n_terms);
  for (int p = 0; p < n; ++p) {
    model.scales.push_back({(1.0 + p) / 2000.0, -0.01 * p});
  }
  fill_with_noise(model);
  return model;
}

/// The weight of a plane is what moving it by a byte does.
TEST(PlaneWeights, AreWhatAByteMovesPicturesBy) {
  for (const ReflectanceModel& model :
       {noisy(ReflectanceBasis::hsh, ReflectanceColour::rgb, 4),
        noisy(ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6), fading_axes()}) {
    const std::vector<double> weights = plane_weights(model);
    ASSERT_EQ(weights.size(), static_cast<std::size_t>(model.n_planes()));
    const std::vector<Eigen::Vector3d> lights = spread_over_hemisphere(64);
    for (int p = 0; p < model.n_planes(); ++p) {
      ReflectanceModel moved = model;
      for (int y = 0; y < kSide; ++y) {
        for (int x = 0; x < kSide; ++x) {
          moved.planes(y, x, p) = static_cast<std::uint8_t>(moved.planes(y, x, p) + 1);
        }
      }
      double squares = 0.0;
      double n = 0.0;
      for (const Eigen::Vector3d& light : lights) {
        const Image<float> a = relit(model, light);
        const Image<float> b = relit(moved, light);
        for (std::size_t i = 0; i < a.pixels().size(); ++i) {
          squares += std::pow(static_cast<double>(b.pixels()[i] - a.pixels()[i]), 2);
          n += 1.0;
        }
      }
      // 4096 pixels are the sample of lrgb, too; what is left is 32-bit pictures.
      EXPECT_NEAR(weights[static_cast<std::size_t>(p)], std::sqrt(squares / n),
                  2e-3 * weights[static_cast<std::size_t>(p)])
          << p;
    }
  }
}

/// A rounding step s is off by s / sqrt(12) in the mean, in every plane alike as the lit
/// picture has it, however much less a plane says.
TEST(WebCoding, EveryPlaneLosesAlikeInTheLitPicture) {
  const ReflectanceModel model = fading_axes();
  const std::vector<double> weights = plane_weights(model);
  constexpr double kQuality = 90.0;
  const ReflectanceModel found =
      decode_web_files(code_web_folder(model, {.quality = kQuality}, "test"), "test");
  const double expected = web_step(kQuality) / 255.0 / std::sqrt(12.0);
  for (int p = 0; p < 6; ++p) {
    double squares = 0.0;
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        squares += std::pow(found.planes(y, x, p) - model.planes(y, x, p), 2);
      }
    }
    const double lost =
        weights[static_cast<std::size_t>(p)] * std::sqrt(squares / (kSide * kSide));
    // Steps are whole bytes, planes are, too, and a step as large as the noise loses the noise.
    std::printf("plane %d: %.5f, a step's mean %.5f\n", p, lost, expected);
    EXPECT_LT(lost, 1.2 * expected) << p;
    EXPECT_GT(lost, (p < 4 ? 0.8 : 0.1) * expected) << p;
  }
}

TEST(WebCoding, QualityIsJpegsOwnScale) {
  EXPECT_DOUBLE_EQ(web_step(100.0), 0.0);
  EXPECT_DOUBLE_EQ(web_step(75.0), 8.0);
  EXPECT_DOUBLE_EQ(web_step(50.0), 16.0);
  EXPECT_DOUBLE_EQ(web_step(25.0), 32.0);
}

TEST(WebTarget, BytesAreKeptAndUsed) {
  const ReflectanceModel model = fading_axes();
  const std::uint64_t best = code_web_folder(model, {.quality = 100.0}, "test").bytes();
  const std::uint64_t least = code_web_folder(model, {.quality = 1.0}, "test").bytes();
  const std::uint64_t requested = (best + least) / 2;
  const WebFiles files = code_to_bytes(model, requested, "test");
  EXPECT_LE(files.bytes(), requested);
  // A 256th of the way to 100 more would not fit.
  EXPECT_GT(code_web_folder(model, {.quality = files.quality + 99.0 / 256.0}, "test").bytes(),
            requested);
  EXPECT_EQ(code_to_bytes(model, best, "test").quality, 100.0);
  try {
    (void)code_to_bytes(model, least - 1, "test");
    FAIL() << "fewer bytes than there are";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find(std::to_string(least)), std::string::npos)
        << error.what();
  }
}

TEST(WebTarget, DecibelsAreAchievedWithTheFewestBytes) {
  const ReflectanceModel model = fading_axes();
  const auto measure = [&](const ReflectanceModel& decoded) {
    return compare_pictures(model, decoded, spread_over_hemisphere(9)).mean_db;
  };
  constexpr double kRequested = 40.0;
  const WebFiles files = code_to_psnr(model, kRequested, measure, "test");
  EXPECT_GE(measure(decode_web_files(files, "test")), kRequested);
  const WebFiles less =
      code_web_folder(model, {.quality = files.quality - 99.0 / 256.0}, "test");
  EXPECT_LT(measure(decode_web_files(less, "test")), kRequested);
  try {
    (void)code_to_psnr(model, 90.0, measure, "test");
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("90.00 dB cannot be achieved"), std::string::npos)
        << error.what();
  }
}

}  // namespace
}  // namespace haarlight::relight
